# SPDX-License-Identifier: Apache-2.0
"""A start state from the first second of flight, or the reason why there is none yet."""

import dataclasses

import numpy as np
import pytest

from uav_vslam.config import BackendConfig, ImuConfig, StartConfig, VehicleConfig
from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.rotation import rpy_from_rotation, so3_exp
from uav_vslam.geometry.stereo import StereoRig
from uav_vslam.slam import in_flight_initializer
from uav_vslam.slam.in_flight_initializer import MIN_VIEWS, InFlightInitializer, Start
from uav_vslam.types import StereoFeatures

WINDOW = 9  # frames at 7.14 Hz that span a second
VELOCITY_M_S = 0.5  # ten flights show 0.2 at most
TILT_DEG = 1.5  # ten flights show 1.0 at most: three sigmas of the accelerometer's bias


def config(**sections) -> VehicleConfig:
    return VehicleConfig(**{"start": StartConfig(method="in_flight"), **sections})


def feed(search: InFlightInitializer, frames) -> Start | None:
    """Return the first start found."""
    return next((found for frame in frames if (found := search.add(*frame)) is not None), None)


def velocity_error(vehicle, start: Start) -> float:
    """Error of the velocity in the body frame, independent of the map [m/s]."""
    state = start.initial.state
    true = vehicle.true_state(state.stamp_ns)
    return float(np.linalg.norm(state.T_map_body.R.T @ state.v_map - true.T_map_body.R.T @ true.v_map))


def blind(frame):
    features, increment = frame
    return StereoFeatures.empty(features.stamp_ns), increment


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_second_of_flight_gives_velocity_and_tilt_at_its_first_frame(flown, seed: int) -> None:
    flight = flown(seed)
    search = InFlightInitializer(flight.vehicle.rig, config())
    found = feed(search, flight.frames)
    assert found is not None
    assert len(found.frames) == WINDOW
    assert [features.stamp_ns for features, _ in found.frames] == [f.stamp_ns for f, _ in flight.frames[:WINDOW]]
    assert search.dropped == 0
    state = found.initial.state
    true = flight.vehicle.true_state(state.stamp_ns)
    assert state.stamp_ns == flight.frames[0][0].stamp_ns
    np.testing.assert_array_equal(state.T_map_body.t, np.zeros(3))
    roll, pitch, yaw = rpy_from_rotation(state.T_map_body.R)
    assert abs(yaw) < 1e-12
    true_roll, true_pitch, _ = rpy_from_rotation(true.T_map_body.R)
    assert np.rad2deg(np.hypot(roll - true_roll, pitch - true_pitch)) < TILT_DEG
    assert velocity_error(flight.vehicle, found) < VELOCITY_M_S


@pytest.mark.parametrize("seed", [1, 4])
@pytest.mark.parametrize(("speed", "altitude"), [(5.0, 5.0), (25.0, 15.0)])
def test_points_in_view_for_a_third_of_a_second_suffice(flown, speed: float, altitude: float, seed: int) -> None:
    flight = flown(seed, frames=40, speed=speed, altitude=altitude, relief_m=0.05 * altitude, frame_rate_hz=10.0)
    search = InFlightInitializer(flight.vehicle.rig, config())
    found = feed(search, flight.frames)
    assert found is not None
    assert search.dropped == 0
    assert len(found.frames) == 11  # what follows the points' view is processed as well
    assert velocity_error(flight.vehicle, found) < VELOCITY_M_S


def test_the_views_are_spread_over_the_time_that_points_are_in_view(flown) -> None:
    """Few of the 30 frames of a second see points of the first one."""
    flight = flown(1, frames=36, speed=10.0, altitude=5.0, relief_m=0.25, frame_rate_hz=30.0)
    search = InFlightInitializer(flight.vehicle.rig, config())
    found = feed(search, flight.frames)
    assert found is not None
    assert search.dropped == 0
    assert velocity_error(flight.vehicle, found) < VELOCITY_M_S


@pytest.mark.parametrize("imu", ["adis16480", "consumer"])
def test_the_prior_has_the_configured_velocity_sigma_and_twice_the_tilt_sigma_of_the_bias(flown, imu: str) -> None:
    flight = flown(1, imu=imu)
    unit = flight.vehicle.scenario.imu_config
    settings = config(imu=unit, start=StartConfig(method="in_flight", velocity_sigma=3.0))
    found = feed(InFlightInitializer(flight.vehicle.rig, settings), flight.frames)
    assert found is not None
    sigma = np.sqrt(np.diag(found.initial.covariance))
    assert np.all(sigma[:3] <= 1e-3)
    np.testing.assert_allclose(sigma[3:6], 3.0)
    hidden = 2.0 * unit.accel_bias_sigma / unit.gravity
    assert np.all((hidden < sigma[6:8]) & (sigma[6:8] < 2.0 * hidden))
    assert sigma[8] < 0.2 * sigma[6]  # yaw is known; the rest is roll in a pitched vehicle
    np.testing.assert_allclose(sigma[9:12], unit.gyro_bias_sigma)
    np.testing.assert_allclose(sigma[12:15], unit.accel_bias_sigma)


def test_frames_without_features_are_dropped_and_counted(flown) -> None:
    flight = flown(1)
    search = InFlightInitializer(flight.vehicle.rig, config())
    dark = 5
    assert feed(search, map(blind, flight.frames[:dark])) is None
    assert search.waiting == dark
    found = feed(search, flight.frames[dark:])
    assert found is not None
    assert found.initial.state.stamp_ns == flight.frames[dark][0].stamp_ns
    assert found.frames[0][1] is None  # the first frame has no increment
    assert search.dropped == dark


def test_the_reason_names_what_is_missing(flown) -> None:
    flight = flown(1)
    search = InFlightInitializer(flight.vehicle.rig, config())
    assert search.reason == "no frame has arrived"
    assert feed(search, flight.frames[:3]) is None
    assert search.reason == "3 frames over 0.3 s have arrived, not yet enough"
    strange = [
        dataclasses.replace(f, descriptors=np.roll(f.descriptors, 17 * k, axis=1))
        for k, (f, _) in enumerate(flight.frames)
    ]
    search = InFlightInitializer(flight.vehicle.rig, config())
    assert feed(search, [(f, i) for f, (_, i) in zip(strange, flight.frames, strict=True)]) is None
    assert (
        f"are matched in the next frames; {MIN_VIEWS} frames with 6 are needed: take images more often" in search.reason
    )
    assert search.dropped == len(flight.frames) - WINDOW + 1


@pytest.mark.parametrize("seed", [2, 5])
def test_equations_without_a_solution_do_not_end_the_search(flown, seed: int) -> None:
    """All points at one place of the images: some diverge while the motion is fitted."""
    flight = flown(seed)
    search, place = InFlightInitializer(flight.vehicle.rig, config()), flight.frames[0][0].pixels[:1]
    for features, increment in flight.frames:
        frozen = dataclasses.replace(features, pixels=np.tile(place, (len(features), 1)))
        assert search.add(frozen, increment) is None
        assert search.waiting < WINDOW
    assert search.dropped == len(flight.frames) - WINDOW + 1
    assert feed(search, flight.frames) is not None


def test_a_wrong_calibration_has_another_reason_than_too_few_features(flown) -> None:
    flight = flown(1)
    rig = flight.vehicle.rig
    turned = Pose(rig.T_body_left.R @ so3_exp([0.0, 0.0, np.pi / 2]), rig.T_body_left.t)
    wrong = StereoRig(rig.left, rig.right, turned, turned @ rig.T_right_left.inverse())
    search = InFlightInitializer(wrong, config())
    assert feed(search, flight.frames) is None
    assert "fit one motion; check calibration, IMU axes and units" in search.reason


def test_a_larger_uncertainty_than_allowed_is_refused(flown, monkeypatch) -> None:
    flight = flown(1)
    monkeypatch.setattr(in_flight_initializer, "MAX_TILT_SIGMA_DEG", 0.1)
    search = InFlightInitializer(flight.vehicle.rig, config())
    assert feed(search, flight.frames) is None
    assert "and tilt to 0." in search.reason
    assert "m/s and 0.1 deg" in search.reason
    assert "imu.accel_bias_sigma leaves 0.29 deg" in search.reason


def test_a_gyro_bias_beyond_the_increments_linearisation_is_refused(flown) -> None:
    """A turn-on bias of 0.3 rad/s: increments are corrected for it to first order only."""
    flight = flown(1)
    search = InFlightInitializer(flight.vehicle.rig, config(imu=ImuConfig(gyro_bias_sigma=0.5)))
    assert feed(search, flight.with_gyro_bias([0.0, 0.0, 0.3])) is None
    assert "the gyro's bias alone rotates by 0.3" in search.reason


@pytest.mark.parametrize("tracked_px", [None, 0.06])
@pytest.mark.parametrize("seed", [1, 2])
def test_a_gyro_bias_far_beyond_its_sigma_is_found_and_named(flown, seed: int, tracked_px: float | None) -> None:
    flight = flown(seed, tracked_px=tracked_px)
    bias = np.array([0.02, -0.015, 0.01])
    settings = config(backend=BackendConfig(sigma_px=tracked_px or 1.0))
    expected = feed(InFlightInitializer(flight.vehicle.rig, settings), flight.frames)
    found = feed(InFlightInitializer(flight.vehicle.rig, settings), flight.with_gyro_bias(bias))
    assert expected is not None
    assert found is not None
    assert expected.warning == ""
    assert "far beyond imu.gyro_bias_sigma, 0.0005 rad/s" in found.warning
    error = found.initial.state.gyro_bias - bias - flight.vehicle.imu.gyro_bias[0]
    assert np.linalg.norm(error) < 3.0 * np.sqrt(found.initial.covariance[9, 9])
    assert velocity_error(flight.vehicle, found) < 2.0 * VELOCITY_M_S


def test_an_accelerometer_in_g_is_named(flown) -> None:
    flight = flown(1)
    per_g = 1.0 / ImuConfig().gravity
    in_g = [
        (f, i and dataclasses.replace(i, delta_v=i.delta_v * per_g, delta_p=i.delta_p * per_g))
        for f, i in flight.frames
    ]
    search = InFlightInitializer(flight.vehicle.rig, config())
    assert feed(search, in_g) is None
    assert "m/s^2, where gravity is 9.81: check its unit and scale; if it has a topic" in search.reason


def test_a_gap_in_the_motion_restarts_the_window(flown) -> None:
    flight = flown(1)
    search = InFlightInitializer(flight.vehicle.rig, config())
    assert feed(search, flight.frames[:4]) is None
    found = feed(search, flight.frames[6:])  # two frames were lost
    assert found is not None
    assert found.initial.state.stamp_ns == flight.frames[6][0].stamp_ns
    assert search.dropped == 4


def test_a_longer_window_uses_some_frames_and_keeps_all(flown, monkeypatch) -> None:
    flight = flown(1)
    monkeypatch.setattr(in_flight_initializer, "WINDOW_S", 2.0)
    found = feed(InFlightInitializer(flight.vehicle.rig, config()), flight.frames)
    assert found is not None
    assert len(found.frames) == 16
    assert velocity_error(flight.vehicle, found) < VELOCITY_M_S


def test_the_same_frames_give_the_same_bytes(flown) -> None:
    flight = flown(2)
    settings = config(backend=BackendConfig(sigma_px=1.0))
    a, b = (feed(InFlightInitializer(flight.vehicle.rig, settings), flight.frames) for _ in range(2))
    assert a is not None
    assert b is not None
    assert a.initial.state.v_map.tobytes() == b.initial.state.v_map.tobytes()
    assert a.initial.state.T_map_body.R.tobytes() == b.initial.state.T_map_body.R.tobytes()
