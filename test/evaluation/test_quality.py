# SPDX-License-Identifier: Apache-2.0
"""Quality without ground truth, on simulated flights whose true noise and gaps are known."""

import csv
import dataclasses
import functools
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import chi2

from uav_vslam.config import BackendConfig, VehicleConfig
from uav_vslam.evaluation.consistency import nees
from uav_vslam.evaluation.frame_table import COLUMNS, write_frames
from uav_vslam.evaluation.quality import (
    claimed_figures,
    innovation_figures,
    longest_without_update_s,
    mean_within_gate,
    quality_figures,
)
from uav_vslam.evaluation.result import VehicleResult
from uav_vslam.evaluation.summary import build_summary
from uav_vslam.offline.result import flight_result
from uav_vslam.offline.track import track_vehicle
from uav_vslam.simulation.landmarks import observe, scatter_landmarks
from uav_vslam.simulation.scenario import SCENARIOS, simulate_vehicle
from uav_vslam.simulation.source import SimulatedSource
from uav_vslam.types import FrameQuality, StereoFeatures

SEEDS = range(1, 5)
FRAMES = 50
DARK = (10, 11, 12, 30)  # frames in which the cameras saw nothing
PERIOD_S = 0.14005602240896359  # of the simulated camera


@functools.cache
def flown(seed: int, *, sigma_px: float = 1.0, dark: tuple[int, ...] = ()) -> VehicleResult:
    """Fly without images; each pixel coordinate has a true standard deviation of 1 px."""
    scenario = dataclasses.replace(SCENARIOS["kagaru"], frames=FRAMES, vehicles=1, seed=seed)
    vehicle = simulate_vehicle(scenario, 0)
    seen = [features for features, _ in observe(vehicle, scatter_landmarks([vehicle]))]
    features = tuple(StereoFeatures.empty(f.stamp_ns) if k in dark else f for k, f in enumerate(seen))
    config = VehicleConfig(imu=scenario.imu_config, backend=BackendConfig(sigma_px=sigma_px))
    track = track_vehicle(SimulatedSource(vehicle, features=features), config)
    name = vehicle.name
    return flight_result("x", {name: track}, {}, {name: None}, {name: config}).vehicles[name]


@pytest.mark.slow
def test_the_innovations_of_flights_with_the_stated_noise_are_consistent() -> None:
    updates: list[FrameQuality] = [frame for seed in SEEDS for frame in flown(seed).frames or ()]
    figures = innovation_figures(updates)
    assert figures["nis_verdict"] == "consistent"
    low, high = figures["nis_band"]
    assert 0.95 < low < figures["nis_per_dof"] < high < 1.02  # 50000 degrees of freedom, gated at 99 %
    assert figures["nis_outside_share"] < 0.1


@pytest.mark.slow
@pytest.mark.parametrize(("sigma_px", "expected"), [(0.5, "over-confident"), (2.0, "conservative")])
def test_a_wrong_pixel_noise_is_named(sigma_px: float, expected: str) -> None:
    figures = innovation_figures(flown(1, sigma_px=sigma_px).frames or ())
    assert figures["nis_verdict"] == expected
    assert figures["nis_outside_share"] > 0.8


def test_the_gate_takes_from_the_mean_what_random_numbers_say() -> None:
    drawn = np.random.default_rng(0).chisquare(4, 1_000_000)
    for probability in (0.5, 0.9, 0.99):
        kept = drawn[drawn <= chi2.ppf(probability, 4)]
        assert mean_within_gate(np.array(probability)) == pytest.approx(kept.mean() / 4, abs=0.004)
    assert mean_within_gate(np.array(1.0)) == 1.0


def test_coasted_frames_are_those_in_which_the_cameras_saw_nothing() -> None:
    vehicle = flown(2, dark=DARK)
    assert vehicle.frames is not None
    assert [k for k, frame in enumerate(vehicle.frames) if frame.coasted] == list(DARK)
    figures = quality_figures(vehicle)
    assert figures is not None
    assert (figures["frames_coasted"], figures["coasted_longest"]) == (4, 3)
    assert figures["without_update_s"] == pytest.approx(4 * PERIOD_S, rel=1e-6)
    assert flown(2).frames is not None
    assert not any(frame.coasted for frame in flown(2).frames or ())  # the first, at the start state, is none either


def test_images_that_were_never_recorded_count_in_the_time_without_update() -> None:
    frames = flown(2).frames or ()
    assert longest_without_update_s(frames[:5] + frames[15:]) == pytest.approx(11 * PERIOD_S, rel=1e-6)
    assert longest_without_update_s(()) == 0.0


def test_claims_are_those_of_the_last_covariance_per_length() -> None:
    track = flown(1).s_slam
    assert track.covariance is not None
    figures = claimed_figures(track, distance_m=250.0)
    last = track.covariance[-1]
    assert figures["sigma_end_m"] == pytest.approx(np.sqrt(last[0, 0] + last[1, 1] + last[2, 2]))
    assert figures["sigma_per_100m_m"] == pytest.approx(figures["sigma_end_m"] / 2.5)
    assert np.radians(figures["sigma_heading_end_deg"]) == pytest.approx(np.sqrt(last[5, 5]))
    assert claimed_figures(track, distance_m=0.0)["sigma_per_100m_m"] is None


def test_a_summary_without_records_of_frames_has_no_quality_and_one_without_an_update_no_verdict(flight) -> None:
    assert build_summary(flight, git=None)["vehicles"]["uav1"]["quality"] is None
    for frames in ((), (flown(1).frames or ())[:1]):
        figures = quality_figures(dataclasses.replace(flown(1), frames=frames))
        assert figures is not None
        assert (figures["nis_per_dof"], figures["nis_verdict"]) == (None, None)


def test_the_table_of_frames_holds_what_the_filter_reported(tmp_path: Path) -> None:
    vehicle = dataclasses.replace(flown(2, dark=DARK), alarms={flown(2).frames[3].stamp_ns: ("left camera",)})
    assert vehicle.frames is not None
    assert vehicle.s_slam.covariance is not None
    write_frames(vehicle, tmp_path / "frames.csv")
    with (tmp_path / "frames.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert tuple(rows[0]) == COLUMNS
    assert [int(row["stamp_ns"]) for row in rows] == [frame.stamp_ns for frame in vehicle.frames]
    assert [k for k, row in enumerate(rows) if row["coasted"] == "1"] == list(DARK)
    assert [k for k, row in enumerate(rows) if row["nis"] == ""] == [0, *DARK]
    for row, frame in zip(rows, vehicle.frames, strict=True):
        assert int(row["associated"]) == frame.associated
        if frame.dof:
            assert float(row["nis_per_dof"]) == pytest.approx(frame.nis / frame.dof, rel=1e-5)
            assert float(row["band_low"]) < 1.0 < float(row["band_high"])
    assert float(rows[-1]["sigma_up_m"]) == pytest.approx(np.sqrt(vehicle.s_slam.covariance[-1, 2, 2]), rel=1e-5)
    last = vehicle.frames[-1]
    assert 0.0 < last.time_offset_sigma_s < vehicle.frames[0].time_offset_sigma_s  # tracks and landmarks show it
    for key, value in (("time_offset_ms", 1e3 * last.time_offset_s), ("disparity_error_px", last.disparity_error_px)):
        assert float(rows[-1][key]) == pytest.approx(value, rel=1e-5)
    assert [row["alarms"] for row in rows[2:5]] == ["", "left camera", ""]
    assert {row["nees_position"] for row in rows} == {""}  # there is no truth


def test_the_table_of_frames_has_the_nees_of_those_with_truth(flight, tmp_path: Path) -> None:
    vehicle = flight.vehicles["uav1"]
    stamps_ns = vehicle.s_slam.stamps_ns.tolist()
    frames = tuple(dataclasses.replace((flown(1).frames or ())[0], stamp_ns=stamp_ns) for stamp_ns in stamps_ns)
    half = vehicle.truth.select(np.arange(60))
    write_frames(dataclasses.replace(vehicle, frames=frames, truth=half), tmp_path / "frames.csv")
    with (tmp_path / "frames.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    expected = nees(vehicle.s_slam, half)
    for column, values in (("nees_position", expected.position), ("nees_rotation", expected.rotation)):
        np.testing.assert_allclose([float(row[column]) for row in rows[:60]], values, rtol=1e-5)
        assert {row[column] for row in rows[60:]} == {""}
