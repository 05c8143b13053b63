# SPDX-License-Identifier: Apache-2.0
import dataclasses

import numpy as np
import pytest

from uav_vslam.config import IMU_GRADES, VehicleConfig
from uav_vslam.errors import ConfigError, FilterDivergence
from uav_vslam.ins.imu_buffer import MAX_HELD_S
from uav_vslam.offline.track import track_vehicle
from uav_vslam.simulation.landmarks import LandmarkNoise
from uav_vslam.simulation.scenario import Scenario, simulate_vehicle
from uav_vslam.simulation.source import SimulatedSource
from uav_vslam.slam.backend import SlamBackend
from uav_vslam.studies.engine.own_only import (
    INS,
    Trial,
    dead_reckon,
    dead_reckoning,
    own_only,
    prepare,
    run_trial,
    run_trials,
)
from uav_vslam.types import NS_PER_S, ImuSample

SHORT = Scenario(frames=12)


@pytest.fixture(scope="module")
def trial():
    return Trial("calm", SHORT, (dead_reckoning(), own_only("eif", {})))


@pytest.fixture(scope="module")
def runs(trial):
    return run_trials([trial], [1, 2], workers=1)


def test_there_is_a_run_of_each_candidate_on_each_vehicle_of_each_seed(runs):
    found = [(run.seed, run.name, run.vehicle) for run in runs]
    assert found == [(s, n, v) for s in (1, 2) for n in (INS, "eif") for v in ("uav1", "uav2")]
    assert all(len(run.track.estimate) == 12 and run.track.failure == "" for run in runs)
    assert np.abs(runs[0].truth.positions - runs[4].truth.positions).max() > 0.01  # another seed is another flight


def test_it_is_what_the_pipeline_gives(runs):
    """The back end is fed directly here; through queues and propagator the same frames must give the same poses."""
    (flight, _) = prepare(dataclasses.replace(SHORT, seed=1), LandmarkNoise())
    source = SimulatedSource(flight.vehicle, flight.landmarks)
    outputs = track_vehicle(source, VehicleConfig(imu=SHORT.imu_config)).outputs
    ins, estimated = runs[0].track.estimate, runs[2].track.estimate
    np.testing.assert_array_equal(estimated.positions, [output.report.pose.T_map_body.t for output in outputs])
    np.testing.assert_array_equal(ins.positions, [output.dead_reckoning.pose.T_map_body.t for output in outputs])


def test_a_frame_has_its_time_its_landmarks_and_its_memory(runs):
    track, seen = runs[2].track, prepare(dataclasses.replace(SHORT, seed=1), LandmarkNoise())[0].steps[0][0]
    assert len(track.frame_ms) == len(track.landmarks) == len(track.resident_mb) == 12
    assert (track.frame_ms > 0).all()
    assert track.landmarks[0] == 0  # they wait for the angular rate
    assert (track.resident_mb > 10).all()  # a Python process with numpy
    synchronised = run_trial((Trial("calm", SHORT, (own_only("eif", {"rig.time_offset_sigma_s": 0.0}),)), 1))
    assert synchronised[0].track.landmarks[0] == min(len(seen), VehicleConfig().backend.max_new_landmarks)


def test_all_candidates_see_the_same_noise(runs):
    again = run_trial((Trial("calm", SHORT, (own_only("other name", {}),)), 2))
    np.testing.assert_array_equal(again[0].track.estimate.positions, runs[6].track.estimate.positions)


def test_the_inertial_unit_is_the_scenarios(monkeypatch, trial):
    told, begin = [], SlamBackend.__init__
    monkeypatch.setattr(
        SlamBackend, "__init__", lambda *args, **options: told.append(options["config"]) or begin(*args, **options)
    )
    run_trial((dataclasses.replace(trial, scenario=dataclasses.replace(SHORT, imu="consumer")), 1))
    assert {config.imu for config in told} == {IMU_GRADES["consumer"]}


def test_a_filter_that_gives_up_leaves_what_it_had(monkeypatch, trial):
    process, frames = SlamBackend.process, []

    def give_up(self, features, increment):
        frames.append(features)
        if len(frames) == 6:
            raise FilterDivergence("indefinite")
        return process(self, features, increment)

    monkeypatch.setattr(SlamBackend, "process", give_up)
    track = run_trial((trial, 1))[2].track
    assert track.failure == "FilterDivergence: indefinite"
    assert len(track.estimate) == len(track.frame_ms) == 5


def test_new_beginnings_are_counted(monkeypatch, trial):
    process = SlamBackend.process
    monkeypatch.setattr(
        SlamBackend, "process", lambda *args: dataclasses.replace(process(*args), recovery="innovations too large")
    )
    track = run_trial((trial, 1))[2].track
    assert (track.restarts, track.failure) == (12, "innovations too large")
    assert len(track.estimate) == 12


def test_a_wrong_setting_is_refused_before_anything_flies():
    with pytest.raises(ConfigError, match="retentoin"):
        own_only("typo", {"backend.retentoin": "grid"})


def test_a_flight_longer_than_readings_are_kept_is_reckoned_whole():
    initial = simulate_vehicle(SHORT, 0).initial
    period_ns, count = NS_PER_S // 20, int(20 * 1.2 * MAX_HELD_S)
    level = np.zeros(3), np.array([0.0, 0.0, SHORT.imu_config.gravity])
    samples = [ImuSample(initial.state.stamp_ns + k * period_ns, *level) for k in range(count)]
    increments, _ = dead_reckon(initial, SHORT.imu_config, samples, [sample.stamp_ns for sample in samples[::20]])
    assert len(increments) == count // 20
    assert all(increment.samples > 0 for increment in increments[1:])
