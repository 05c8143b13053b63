# SPDX-License-Identifier: Apache-2.0
"""Starts have the errors that their covariance states, and the images of a recording are searched once."""

import dataclasses

import numpy as np
import pytest

from uav_vslam.config import ImuConfig, VehicleConfig, load_vehicle
from uav_vslam.datasets.starts import drawn_start
from uav_vslam.errors import UavVslamError
from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.rotation import so3_exp, so3_log
from uav_vslam.simulation.scenario import Scenario, simulate_vehicle
from uav_vslam.simulation.source import SimulatedSource
from uav_vslam.studies.engine.flights import true_trajectory
from uav_vslam.studies.engine.recorded_flights import searched
from uav_vslam.studies.euroc.starts import start_at_frame, starts_of
from uav_vslam.types import NavEstimate, NavState, StereoFeatures, StereoFrame
from uav_vslam.vision.stereo_points import StereoFrontend

DRAWS = 2000
SIGMA = np.repeat([0.1, 0.2, 0.03, 0.01, 0.05], 3)
TINY = Scenario(frames=8, vehicles=1, scale=0.125)


@pytest.fixture(scope="module")
def centre():
    """A start whose errors are correlated, far from the identity attitude."""
    L = np.diag(SIGMA) @ (np.eye(15) + 0.5 * np.tri(15, k=-1))
    pose = Pose(so3_exp(np.array([0.3, -1.0, 2.0])), np.array([1.0, 2.0, 3.0]))
    return NavEstimate(NavState(0, pose, np.ones(3), np.full(3, 0.1), np.full(3, 0.2)), L @ L.T)


@pytest.fixture(scope="module")
def vehicle():
    return simulate_vehicle(TINY, 0)


@pytest.fixture(scope="module")
def flight(vehicle):
    velocities = vehicle.truth.velocity(vehicle.frame_times_s)
    source = SimulatedSource(vehicle)
    return searched(source, VehicleConfig(), truth=true_trajectory(vehicle), velocities=velocities)


def error_of(estimate, truth):
    """Return the (15,) error as `NavEstimate` defines it: R_true = Exp(xi) R, all else truth minus estimate."""
    xi = so3_log(truth.T_map_body.R @ estimate.T_map_body.R.T)
    pairs = (
        (truth.v_map, estimate.v_map),
        (truth.gyro_bias, estimate.gyro_bias),
        (truth.accel_bias, estimate.accel_bias),
    )
    velocity, gyro, accel = (true - mean for true, mean in pairs)
    return np.concatenate([truth.T_map_body.t - estimate.T_map_body.t, velocity, xi, gyro, accel])


def test_drawn_errors_have_the_stated_covariance(centre):
    rng = np.random.default_rng(1)
    errors = np.array([error_of(drawn_start(centre, rng).state, centre.state) for _ in range(DRAWS)])
    white = np.linalg.solve(np.linalg.cholesky(centre.covariance), errors.T)
    bound = 6.0 / np.sqrt(DRAWS)  # six standard deviations of a mean or a correlation; 1.4 times more for a variance
    np.testing.assert_allclose(white.mean(axis=1), 0.0, atol=bound)
    np.testing.assert_allclose(white @ white.T / DRAWS, np.eye(15), atol=1.5 * bound)


def test_a_drawn_start_states_the_covariance_that_it_was_drawn_from(centre):
    drawn = drawn_start(centre, np.random.default_rng(1))
    np.testing.assert_array_equal(drawn.covariance, centre.covariance)
    assert drawn.state.stamp_ns == centre.state.stamp_ns


def test_the_same_seed_draws_the_same_start_and_another_seed_another(flight):
    first, again = (starts_of(flight, ImuConfig(), [4, 5]) for _ in range(2))
    assert [start.name for start in first] == ["recorded", "drawn 4", "drawn 5", "frame 2", "frame 4", "frame 6"]
    positions = [[start.estimate.state.T_map_body.t for start in starts] for starts in (first, again)]
    np.testing.assert_array_equal(*positions)
    assert not np.array_equal(positions[0][1], positions[0][2])


def test_a_later_start_is_the_truth_with_biases_that_have_walked(flight, vehicle):
    imu = ImuConfig(gyro_bias_walk=1e-3, accel_bias_walk=1e-2)
    start, recorded = start_at_frame(flight, 4, imu), flight.initial_state
    time_s = vehicle.frame_times_s[4]
    assert start.state.stamp_ns == vehicle.frame_stamps_ns[4]
    np.testing.assert_allclose(start.state.T_map_body.t, vehicle.truth.position(time_s), atol=1e-9)
    np.testing.assert_allclose(start.state.T_map_body.R, vehicle.truth.rotation(time_s), atol=1e-9)
    np.testing.assert_allclose(start.state.v_map, vehicle.truth.velocity(time_s), atol=1e-9)
    np.testing.assert_array_equal(start.state.accel_bias, recorded.state.accel_bias)
    grown = np.diag(start.covariance - recorded.covariance)
    np.testing.assert_allclose(grown, np.repeat([0, 0, 0, 1e-6 * time_s, 1e-4 * time_s], 3), rtol=1e-6, atol=1e-15)


def test_a_later_start_between_two_truths_has_the_velocity_between_theirs(flight, vehicle):
    every_other = dataclasses.replace(
        flight, truth=flight.truth.select(np.arange(0, 8, 2)), velocities=flight.velocities[::2]
    )
    start = start_at_frame(every_other, 3, ImuConfig())
    np.testing.assert_allclose(start.state.v_map, 0.5 * (flight.velocities[2] + flight.velocities[4]))
    np.testing.assert_allclose(start.state.T_map_body.t, flight.truth.positions[[2, 4]].mean(axis=0))


def test_a_later_start_without_a_truth_is_refused(flight):
    short = dataclasses.replace(flight, truth=flight.truth.select(np.arange(3)), velocities=flight.velocities[:3])
    with pytest.raises(UavVslamError, match="frame 4: no truth"):
        start_at_frame(short, 4, ImuConfig())


def test_images_are_searched_once_and_readings_stay(vehicle, monkeypatch):
    seen = []
    process = StereoFrontend.process
    monkeypatch.setattr(StereoFrontend, "process", lambda self, frame: (seen.append(frame), process(self, frame))[1])
    advanced = []
    flight = searched(
        SimulatedSource(vehicle),
        load_vehicle(None, overrides={"frontend.method": "sift"}),
        truth=true_trajectory(vehicle),
        velocities=np.zeros((TINY.frames, 3)),
        on_frame=lambda: advanced.append(1),
    )
    assert len(seen) == len(advanced) == TINY.frames
    assert all(isinstance(frame, StereoFrame) for frame in seen)
    assert sum(isinstance(event, StereoFeatures) for event in flight.events) == TINY.frames
    assert len(flight.events) == len(list(SimulatedSource(vehicle).iter_events()))
    assert all(a.stamp_ns <= b.stamp_ns for a, b in zip(flight.events, flight.events[1:], strict=False))


def test_the_configured_front_end_searches_with_the_configured_uncertainty_of_the_rig(vehicle):
    def found(overrides):
        config, velocities = load_vehicle(None, overrides=overrides), np.zeros((TINY.frames, 3))
        flight = searched(SimulatedSource(vehicle), config, truth=true_trajectory(vehicle), velocities=velocities)
        return [event for event in flight.events if isinstance(event, StereoFeatures)]

    assert any((frame.tracks > 0).any() for frame in found({"frontend.method": "klt"}))
    sift, doubted = {"frontend.method": "sift"}, {"rig.flexing": True, "rig.attitude_sigma_deg": 2.0}
    assert sum(map(len, found(sift | doubted))) != sum(map(len, found(sift)))  # the epipolar gate is wider


def test_a_pair_that_is_refused_shows_nothing_and_the_others_are_searched(vehicle):
    class Cut(SimulatedSource):
        """The second left image has lost rows."""

        def iter_events(self):
            stamp_ns = int(vehicle.frame_stamps_ns[1])
            for event in super().iter_events():
                broken = isinstance(event, StereoFrame) and event.stamp_ns == stamp_ns
                yield dataclasses.replace(event, left=event.left[5:]) if broken else event

    found = searched(Cut(vehicle), VehicleConfig(), truth=true_trajectory(vehicle), velocities=np.zeros((8, 3)))
    assert [len(e) == 0 for e in found.events if isinstance(e, StereoFeatures)] == [False, True] + 6 * [False]


def test_a_recording_without_a_start_is_refused(vehicle):
    @dataclasses.dataclass
    class Nowhere:
        vehicle = "uav1"
        initial_state = None

    with pytest.raises(UavVslamError, match="initial_state"):
        searched(Nowhere(), VehicleConfig(), truth=true_trajectory(vehicle), velocities=np.zeros((8, 3)))
