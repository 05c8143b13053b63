# SPDX-License-Identifier: Apache-2.0
"""One scenario is one flight: deterministic, with independent streams, and a start with the stated uncertainty."""

import dataclasses

import numpy as np
import pytest

from uav_vslam.errors import ConfigError
from uav_vslam.geometry.rotation import so3_log
from uav_vslam.simulation.rig import kagaru_rig
from uav_vslam.simulation.scenario import SCENARIOS, Scenario, initial_estimate, simulate_fleet, simulate_vehicle
from uav_vslam.simulation.trajectory import Trajectory

SHORT = dataclasses.replace(SCENARIOS["kagaru"], frames=20)


def test_the_same_seed_gives_the_same_bytes() -> None:
    first, second = simulate_vehicle(SHORT, 1), simulate_vehicle(SHORT, 1)
    assert first.imu.gyro.tobytes() == second.imu.gyro.tobytes()
    assert first.initial.covariance.tobytes() == second.initial.covariance.tobytes()
    assert first.initial.state.T_map_body.R.tobytes() == second.initial.state.T_map_body.R.tobytes()


def test_vehicles_and_seeds_differ() -> None:
    one, other_vehicle = simulate_fleet(SHORT)
    other_seed = simulate_vehicle(dataclasses.replace(SHORT, seed=2), 0)
    for other in (other_vehicle, other_seed):
        assert not np.allclose(one.imu.gyro, other.imu.gyro)
        assert not np.allclose(one.initial.state.v_map, other.initial.state.v_map)


def test_a_changed_camera_does_not_change_the_flight() -> None:
    plain, shaken = simulate_vehicle(SHORT, 0), simulate_vehicle(dataclasses.replace(SHORT, vibration_deg=0.02), 0)
    assert plain.imu.accel.tobytes() == shaken.imu.accel.tobytes()
    assert np.any(shaken.right_rotations)
    assert not np.any(plain.right_rotations)


def test_the_initial_error_has_the_stated_covariance() -> None:
    errors = []
    for seed in range(300):
        v = simulate_vehicle(dataclasses.replace(SHORT, seed=seed, frames=2), 0)
        truth, state = v.true_state(int(v.frame_stamps_ns[0])), v.initial.state
        xi = so3_log(truth.T_map_body.R @ state.T_map_body.R.T)
        errors.append(
            np.concatenate(
                [
                    truth.T_map_body.t - state.T_map_body.t,
                    truth.v_map - state.v_map,
                    xi,
                    truth.gyro_bias - state.gyro_bias,
                    truth.accel_bias - state.accel_bias,
                ]
            )
        )
    sigma = np.sqrt(np.diag(v.initial.covariance))
    np.testing.assert_allclose(np.std(errors, axis=0) / sigma, 1.0, atol=0.15)


def test_the_initial_attitude_error_is_about_the_maps_axes() -> None:
    banked = np.tile([1.0, 0.3, 2.0], (20, 1))
    truth = Trajectory(0, np.arange(-1.0, 1.0, 0.1), np.zeros((20, 3)), banked)
    rng = np.random.default_rng(1)
    estimates = [initial_estimate(SHORT, truth, rng=rng).state.T_map_body.R for _ in range(500)]
    xi = so3_log(truth.rotation(0.0) @ np.swapaxes(estimates, -1, -2))
    expected = np.diag(np.deg2rad([SHORT.sigma_tilt_deg, SHORT.sigma_tilt_deg, SHORT.sigma_yaw_deg]) ** 2)
    np.testing.assert_allclose(np.cov(xi.T), expected, atol=0.1 * expected.max())


def test_readings_enclose_all_frames() -> None:
    for v in simulate_fleet(SHORT):
        assert v.imu.stamps_ns[0] < v.frame_stamps_ns[0]
        assert v.imu.stamps_ns[-1] >= v.frame_stamps_ns[-1]
        assert set(np.diff(v.imu.stamps_ns)) == {5_000_000}


def test_the_rig_points_down_with_its_baseline_along_the_image_vertical() -> None:
    rig = kagaru_rig()
    np.testing.assert_allclose(rig.T_body_left.R @ [0.0, 0.0, 1.0], [0.0, 0.0, -1.0])
    np.testing.assert_allclose(rig.T_body_left.R @ [0.0, -1.0, 0.0], [1.0, 0.0, 0.0])  # image up is forward
    z = rig.project(np.array([0.0, 0.0, 70.0]))
    ideal_v = rig.right.cy + rig.right.fy * (-0.776 / 70.0)
    assert rig.baseline_m == pytest.approx(0.776, abs=1e-3)
    assert z[3] - ideal_v == pytest.approx(rig.right.fy * 0.01112, abs=1.0)  # the rest is the convergence angle


def test_a_scaled_rig_sees_the_same_rays() -> None:
    full, half = kagaru_rig(), kagaru_rig(0.5)
    points = np.array([[3.0, -4.0, 70.0], [-10.0, 12.0, 65.0]])
    np.testing.assert_allclose((full.project(points) + 0.5) * 0.5 - 0.5, half.project(points), atol=1e-9)
    assert (half.left.width, half.left.height) == (640, 480)


def test_a_wrong_scenario_is_refused() -> None:
    for wrong in (
        {"pattern": "spiral"},
        {"imu": "toy"},
        {"frames": 1},
        {"scale": 2.0},
        {"contrast": -0.1},
        {"frame_rate_hz": 1e12},
        {"frames": 10**12},
        {"blur_px": 1e9},
        {"noise_sigma": 1e9},
        {"vibration_deg": 90.0},
    ):
        with pytest.raises(ConfigError):
            Scenario(**wrong)  # type: ignore[arg-type]
