# SPDX-License-Identifier: Apache-2.0
"""Every filter flies from every start over the same features, and what went wrong is counted."""

import dataclasses
import pickle

import numpy as np
import pytest

from uav_vslam.config import VehicleConfig
from uav_vslam.errors import FilterDivergence
from uav_vslam.simulation.landmarks import scatter_landmarks
from uav_vslam.simulation.scenario import Scenario, simulate_vehicle
from uav_vslam.simulation.source import SimulatedSource
from uav_vslam.studies.engine.flights import true_trajectory
from uav_vslam.studies.engine.recorded_flights import searched
from uav_vslam.studies.euroc import compute as euroc
from uav_vslam.studies.euroc.compute import error_series, run_start, run_starts, table_rows
from uav_vslam.studies.euroc.starts import Start
from uav_vslam.types import StereoFeatures

FRAMES = 12
STARTS = ["recorded", "drawn 1", "frame 3", "frame 6", "frame 9"]


@pytest.fixture(scope="module")
def flight():
    vehicle = simulate_vehicle(Scenario(frames=FRAMES), 0)
    source = SimulatedSource(vehicle, scatter_landmarks([vehicle]))
    velocities = vehicle.truth.velocity(vehicle.frame_times_s)
    return searched(source, VehicleConfig(), truth=true_trajectory(vehicle), velocities=velocities)


@pytest.fixture(scope="module")
def runs(flight):
    return run_starts(flight, VehicleConfig(), filters=("eif", "ekf"), seeds=[1])


def blinded(flight, frames):
    """Return the flight with nothing to see in some frames."""
    stamps = flight.frame_stamps_ns[list(frames)]
    events = tuple(
        StereoFeatures.empty(event.stamp_ns)
        if isinstance(event, StereoFeatures) and event.stamp_ns in stamps
        else event
        for event in flight.events
    )
    return dataclasses.replace(flight, events=events)


def test_every_filter_flies_from_every_start_to_the_end(runs):
    assert [(run.method, run.start) for run in runs] == [(name, start) for name in ("eif", "ekf") for start in STARTS]
    assert [len(run.track) for run in runs] == 2 * [FRAMES, FRAMES, 9, 6, 3]


def test_the_filter_is_the_one_that_the_row_names(flight, monkeypatch):
    chosen = []
    fly = euroc.track_vehicle
    monkeypatch.setattr(
        euroc, "track_vehicle", lambda source, config: (chosen.append(config.backend.filter), fly(source, config))[1]
    )
    run_starts(flight, VehicleConfig(), filters=("ukf",), seeds=[])
    assert chosen == 4 * ["ukf"]


def test_a_run_with_a_state_of_the_truth_begins_at_the_truth(flight, runs):
    later = next(run for run in runs if run.start == "frame 6")
    np.testing.assert_array_equal(later.track.stamps_ns, flight.frame_stamps_ns[6:])
    np.testing.assert_array_equal(later.track.positions[0], flight.truth.positions[6])


def test_frames_that_show_nothing_known_are_lost_but_not_the_first(flight):
    (run, *_) = run_starts(blinded(flight, [0, 4, 5]), VehicleConfig(), filters=("eif",), seeds=[])
    # Frame 1 meets an empty map after the blind frame 0, so it is lost as well.
    assert np.flatnonzero(run.associated == 0).tolist() == [0, 1, 4, 5]
    assert run.lost == 3


def test_a_filter_that_diverges_is_counted_and_the_others_fly_on(flight, monkeypatch):
    def fly(source, config):
        if config.backend.filter == "ukf":
            raise FilterDivergence("covariance at 1 s is not positive definite")
        return track(source, config)

    track = euroc.track_vehicle
    monkeypatch.setattr(euroc, "track_vehicle", fly)
    runs = run_starts(flight, VehicleConfig(), filters=("ukf", "eif"), seeds=[])
    worst = table_rows(flight, runs)[:2]
    assert [row["failures"] for row in worst] == [4, 0]
    assert worst[0]["ate_worst_m"] is None
    assert worst[1]["ate_worst_m"] > 0
    failed = table_rows(flight, runs)[2]
    assert failed["failure"] == "covariance at 1 s is not positive definite"
    assert failed["ate_rms_m"] is None


def test_the_worst_row_is_over_all_starts(flight, runs):
    rows = table_rows(flight, runs)
    worst, every = rows[:2], rows[2:]
    assert [row["method"] for row in worst] == ["eif", "ekf"]
    for row in worst:
        own = [run for run in every if run["method"] == row["method"]]
        assert row["runs"] == len(own) == len(STARTS)
        assert row["ate_worst_m"] == max(run["ate_rms_m"] for run in own)
        assert row["frames_coasted_worst"] == max(run["frames_coasted"] for run in own)


def test_runs_are_pooled_without_scores_that_none_of_them_has(flight, runs):
    def without_attitude(truth):
        return dataclasses.replace(truth, quaternions_wxyz=np.tile([1.0, 0.0, 0.0, 0.0], (len(truth), 1)))

    def turning(track):
        angle = np.linspace(0.0, 1.0, len(track))
        quaternions = np.column_stack([np.cos(angle), np.zeros((len(track), 2)), np.sin(angle)])
        return dataclasses.replace(track, quaternions_wxyz=quaternions)

    turned = [dataclasses.replace(run, track=turning(run.track)) for run in runs]
    worst = table_rows(dataclasses.replace(flight, truth=without_attitude(flight.truth)), turned)[0]
    assert worst["ate_worst_m"] > 0
    assert [worst[key] for key in ("nees_rotation", "nees_rotation_worst")] == [None, None]


def test_the_error_over_time_is_the_distance_from_the_truth(flight, runs):
    curves = error_series(flight, runs)
    later = next(curve for curve in curves if curve["condition"] == "frame 6")
    assert later["error_m"][0] == 0.0
    assert later["time_s"][0] == pytest.approx((flight.frame_stamps_ns[6] - flight.frame_stamps_ns[0]) / 1e9)
    first = table_rows(flight, runs)[2]
    assert curves[0]["error_m"][-1] == pytest.approx(first["end_rms_m"])
    assert max(curves[0]["error_m"]) == pytest.approx(first["error_max_m"])


def test_a_job_that_travelled_to_another_process_gives_the_same(flight, runs):
    start = Start("recorded", flight.initial_state)
    job = pickle.loads(pickle.dumps((flight, VehicleConfig(), "eif", start)))
    np.testing.assert_array_equal(run_start(job).track.positions, runs[0].track.positions)
