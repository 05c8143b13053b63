# SPDX-License-Identifier: Apache-2.0
import dataclasses
import json

import numpy as np
import pytest

from uav_vslam.evaluation.scores import ERROR_KEYS, NEES_KEYS
from uav_vslam.evaluation.summary import build_summary


def test_the_summary_has_exactly_the_documented_keys(flight):
    summary = build_summary(flight, git="abc1234")
    assert {"name", "seed", "mode", "git", "duration_s", "realtime_factor", "vehicles", "pooled"} <= set(summary)
    vehicle = summary["vehicles"]["uav2"]
    assert {"distance_m", "frames_in", "frames_processed", "closures", "ins", "s_slam", "c_slam", "link"} <= set(
        vehicle
    )
    assert set(vehicle["link"]) == {
        "sent_bytes_per_s", "packets_sent", "packets_received", "packets_used", "packets_waiting", "dropped"
    }  # fmt: skip
    assert {"ate_m", "end_m"} <= set(vehicle["ins"])
    assert {"ate_m", "end_m", "nees_position"} <= set(vehicle["s_slam"])
    assert set(vehicle["c_slam"]) == set(vehicle["s_slam"])
    assert set(summary["pooled"]) == {"ins", "s_slam", "c_slam", "smoothed"}
    assert (summary["git"], summary["seed"], summary["realtime_factor"]) == ("abc1234", 3, 0.5)


def test_figures_are_those_of_the_known_errors(flight):
    figures = build_summary(flight, git=None)["vehicles"]["uav1"]
    for track, sigma_m in (("ins", 4.0), ("s_slam", 1.0), ("c_slam", 0.5)):
        assert figures[track]["ate_m"] == pytest.approx(sigma_m * np.sqrt(3), rel=0.1)
    assert figures["s_slam"]["nees_position"] == pytest.approx(1.0, abs=0.25)
    assert figures["distance_m"] == pytest.approx(20.0 * 11.9, rel=0.01)
    assert figures["link"]["dropped"] == {"stale": 1}


def test_aligned_errors_have_no_nees_beside_them(flight):
    figures = build_summary(flight, git=None, alignment="yaw")["vehicles"]["uav1"]["s_slam"]
    assert figures["ate_m"] is not None
    assert {key: value for key, value in figures.items() if key.startswith("nees") and value is not None} == {}


def test_pooling_takes_the_rms_of_errors_and_the_mean_of_nees(flight):
    summary = build_summary(flight, git=None)
    one, two = (summary["vehicles"][name]["c_slam"] for name in ("uav1", "uav2"))
    pooled = summary["pooled"]["c_slam"]
    assert pooled["ate_m"] == pytest.approx(np.sqrt((one["ate_m"] ** 2 + two["ate_m"] ** 2) / 2))
    assert pooled["end_m"] == pytest.approx(np.sqrt((one["end_m"] ** 2 + two["end_m"] ** 2) / 2))
    key = "rpe_100m_across_m"
    assert pooled[key] == pytest.approx(np.sqrt((one[key] ** 2 + two[key] ** 2) / 2))
    for key in NEES_KEYS:
        assert pooled[key] == pytest.approx((one[key] + two[key]) / 2)
    assert "nees_position" not in summary["pooled"]["ins"]


def test_without_truth_or_peer_there_are_nulls(single_flight):
    summary = build_summary(single_flight, git=None)
    figures = summary["vehicles"]["uav1"]
    assert figures["c_slam"] is None
    assert summary["pooled"]["c_slam"] is None
    assert figures["s_slam"]["ate_m"] is None
    assert figures["s_slam"]["nees_position"] is None
    known = {key: value for key, value in summary["pooled"]["s_slam"].items() if value is not None}
    assert known == {"sigma_end_m": figures["s_slam"]["sigma_end_m"]}
    assert {*ERROR_KEYS, *NEES_KEYS} <= set(summary["pooled"]["s_slam"])
    assert summary["realtime_factor"] is None
    assert figures["distance_m"] > 200.0


def test_a_fast_ins_is_scored_at_the_slam_stamps(flight):
    vehicle = flight.vehicles["uav1"]
    half = vehicle.s_slam.select(np.arange(0, 120, 2))
    sparse = dataclasses.replace(vehicle, s_slam=half)
    figures = build_summary(dataclasses.replace(flight, vehicles={"uav1": sparse}), git=None)["vehicles"]["uav1"]
    error = np.linalg.norm(vehicle.ins.positions[::2] - vehicle.truth.positions[::2], axis=1)
    assert figures["ins"]["ate_m"] == pytest.approx(np.sqrt(np.mean(error**2)), abs=1e-9)
    assert figures["c_slam"]["poses"] == len(half)


def test_a_lost_covariance_becomes_null_and_stays_json(flight):
    vehicle = flight.vehicles["uav1"]
    broken = vehicle.s_slam.covariance.copy()
    broken[80] = np.nan
    vehicle = dataclasses.replace(vehicle, s_slam=dataclasses.replace(vehicle.s_slam, covariance=broken))
    summary = build_summary(dataclasses.replace(flight, vehicles={"uav1": vehicle}), git=None)
    assert summary["vehicles"]["uav1"]["s_slam"]["nees_position"] is None
    assert summary["vehicles"]["uav1"]["s_slam"]["nees_invalid"] == 1
    json.dumps(summary, allow_nan=False)


def test_a_vehicle_without_any_estimate_is_summarised(flight):
    vehicle = flight.vehicles["uav1"]
    empty = vehicle.s_slam.select(np.zeros(0, np.intp))
    lost = dataclasses.replace(vehicle, s_slam=empty, ins=empty, c_slam=empty, frames_processed=0)
    figures = build_summary(dataclasses.replace(flight, vehicles={"uav1": lost}), git=None)["vehicles"]["uav1"]
    assert figures["distance_m"] == 0.0
    assert figures["s_slam"]["ate_m"] is None
