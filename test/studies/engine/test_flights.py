# SPDX-License-Identifier: Apache-2.0
import dataclasses
import math

import numpy as np
import pytest

from uav_vslam.config import FrontendConfig, VehicleConfig
from uav_vslam.evaluation.consistency import Nees
from uav_vslam.evaluation.scores import ERROR_KEYS, NEES_KEYS
from uav_vslam.simulation.scenario import Scenario
from uav_vslam.studies.engine.flight_rows import flight_rows, fly_all, method_rows, nees_series
from uav_vslam.studies.engine.flights import TRACKS, Method, Outcome, with_backend
from uav_vslam.studies.engine.score_columns import COLUMN_OF

pytestmark = pytest.mark.slow

SHORT = Scenario(frames=25)
FIELDS = {
    "method",
    "condition",
    *(COLUMN_OF.get(key, key) for key in ERROR_KEYS),
    "ratio_to_s_slam",
    "end_ratio_to_ins",
    *NEES_KEYS,
    "processed_share",
    "failures",
    "runs",
    "ms_front_end",
    "ms_per_frame",
}


@pytest.fixture(scope="module")
def rows():
    methods = [
        Method("ri15", "landmarks", SHORT),
        Method("euler9", "landmarks", SHORT, with_backend(VehicleConfig(), model="euler9")),
    ]
    return flight_rows(methods, fly_all(methods, [1, 2], workers=1))


def test_each_track_has_a_row_and_the_ins_only_one(rows):
    assert [row["method"] for row in rows] == ["INS", "S-SLAM ri15", "C-SLAM ri15", "S-SLAM euler9", "C-SLAM euler9"]
    assert all(set(row) == FIELDS for row in rows)


def test_ratios_belong_to_their_own_method(rows):
    ins, own, fused = rows[:3]
    assert math.isclose(own["end_ratio_to_ins"], own["end_rms_m"] / ins["end_rms_m"])
    assert math.isclose(fused["ratio_to_s_slam"], fused["ate_rms_m"] / own["ate_rms_m"])
    assert rows[3]["ratio_to_s_slam"] == 1.0


def test_ratio_and_nees_have_their_interval_over_the_seeds():
    method = Method("ri15", "landmarks", SHORT)

    def outcome(seed: int, fused_m: float, nees: float) -> Outcome:
        tracks = {"ins": {"ate_m": 9.0}, "s_slam": {"ate_m": 2.0}, "c_slam": {"ate_m": fused_m, "nees_position": nees}}
        return Outcome(method, seed, {name: {"uav1": of} for name, of in tracks.items()}, ms_per_frame=1.0)

    outcomes = [outcome(1, 1.0, 0.5), outcome(2, 1.6, 0.5), outcome(3, 1.0, 2.0)]
    ins, _, fused = method_rows(method, outcomes, TRACKS)
    assert (fused["ratio_low"], fused["ratio_high"]) == pytest.approx((0.5, 0.8))  # all draws of one seed
    assert (fused["nees_position_low"], fused["nees_position_high"]) == pytest.approx((0.5, 2.0))
    assert "nees_position_low" not in ins


def test_nees_over_time_is_the_mean_of_the_runs_that_lost_no_frame():
    method, stamps_ns = Method("ri15", "landmarks", Scenario(frames=3, vehicles=2)), 7 + 140_000_000 * np.arange(3)

    def outcome(seed: int, *values: float, frames: int = 3) -> Outcome:
        of_vehicles = [Nees(stamps_ns[:frames], np.full(frames, v), np.full(frames, 2 * v)) for v in values]
        return Outcome(method, seed, None, 1.0, curves={"s_slam": of_vehicles, "c_slam": of_vehicles[:1]})

    own, fused = nees_series([method], [outcome(1, 1.0, 2.0), outcome(2, 3.0, 4.0), outcome(3, 9.0, frames=2)])
    assert own["nees_position"] == [2.5] * 3
    assert own["nees_rotation"] == [5.0] * 3
    assert fused["nees_position"] == [2.0] * 3
    assert own["time_s"] == pytest.approx([0.0, 0.14, 0.28])
    assert (own["runs"], fused["runs"]) == (4, 2)


def test_a_vehicle_on_its_own_has_no_row_of_a_fused_track():
    method = Method("ri15", "landmarks", dataclasses.replace(SHORT, vehicles=1))
    outcomes = fly_all([method], [1], workers=1)
    ins, own = flight_rows([method], outcomes)
    assert (ins["method"], own["method"]) == ("INS", "S-SLAM ri15")
    assert "ratio_to_s_slam" not in own
    assert own["ms_front_end"] is None
    (curve,) = nees_series([method], outcomes)
    assert np.mean(curve["nees_position"][20:]) == pytest.approx(own["nees_position"], abs=1e-3)


def test_a_smoothed_track_is_scored_and_timed_beside_the_filters_which_it_leaves_as_it_was():
    method = Method("ri15", "landmarks", dataclasses.replace(SHORT, vehicles=1))
    smoothed = dataclasses.replace(method, smoothing=True)
    outcomes = fly_all([method, smoothed], [1], workers=1)
    plain, (_, own, whole) = flight_rows([method], outcomes), flight_rows([smoothed], outcomes)
    assert whole["method"] == "smoothed ri15"
    assert (own["ate_rms_m"], own["nees_position"]) == (plain[1]["ate_rms_m"], plain[1]["nees_position"])
    assert whole["rpe_14m_along_m"] < own["rpe_14m_along_m"]  # it knows what came later
    assert whole["ms_per_frame"] > 0.0
    assert whole["ms_per_frame"] != own["ms_per_frame"]


def test_every_frame_is_processed_and_nothing_fails(rows):
    assert all(row["processed_share"] == 1.0 and row["failures"] == 0 for row in rows)


def test_rendered_images_are_searched_once_for_both_inertial_grades(monkeypatch):
    from uav_vslam.vision.stereo_points import StereoFrontend

    searched = []
    detect = StereoFrontend.detect
    monkeypatch.setattr(StereoFrontend, "detect", lambda self, frame: (searched.append(1), detect(self, frame))[1])
    small = {"frames": 3, "vehicles": 1, "scale": 0.25}
    config = VehicleConfig(frontend=FrontendConfig(method="sift"))
    grades = ("adis16480", "consumer")
    methods = [Method("ri15", imu, Scenario(imu=imu, **small), config, rendered=True) for imu in grades]
    rows = flight_rows(methods, fly_all(methods, [1], workers=1))
    assert all(row["ms_front_end"] > 0 for row in rows if row["method"] != "INS")
    assert len(searched) == 3
    assert {row["condition"] for row in rows} == {"adis16480", "consumer"}
