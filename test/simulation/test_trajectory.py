# SPDX-License-Identifier: Apache-2.0
"""True motion and ideal IMU readings are consistent."""

import numpy as np
import pytest

from uav_vslam.geometry.rotation import so3_exp, so3_log
from uav_vslam.simulation.flight_path import PATTERNS, Disturbance, Roughness, fly
from uav_vslam.simulation.imu import ideal_imu
from uav_vslam.simulation.scenario import SCENARIOS, simulate_vehicle
from uav_vslam.simulation.trajectory import Trajectory

GRAVITY = 9.80665
STILL = Disturbance(0.0, 0.1, 1.0)
SMOOTH = Roughness(STILL, STILL, STILL, STILL, STILL, STILL)

INS_POSITION_M = 0.05  # midpoint rule at 200 Hz in vibration, after 22 s
INS_ATTITUDE_RAD = 2e-5


@pytest.fixture(scope="module")
def truth() -> Trajectory:
    return simulate_vehicle(SCENARIOS["kagaru"], 0).truth


def smooth_flight(pattern: str, duration_s: float = 60.0) -> Trajectory:
    return fly(
        PATTERNS[pattern](duration_s, 20.0),
        start_ns=0,
        duration_s=duration_s,
        speed=20.0,
        altitude=70.0,
        offset_world=(0.0, 0.0),
        rng=np.random.default_rng(0),
        roughness=SMOOTH,
    )


def test_ideal_readings_integrate_back_to_the_pose(truth: Trajectory) -> None:
    dt = 0.005
    stamps = truth.start_ns + np.arange(0, 22_000_000_001, 5_000_000, dtype=np.int64)
    imu = ideal_imu(truth, stamps, gravity=GRAVITY)
    R, p, v = truth.rotation(0.0), truth.position(0.0), truth.velocity(0.0)
    for k in range(len(stamps) - 1):
        rate, force = 0.5 * (imu.gyro[k] + imu.gyro[k + 1]), 0.5 * (imu.accel[k] + imu.accel[k + 1])
        acceleration = R @ so3_exp(0.5 * dt * rate) @ force - [0.0, 0.0, GRAVITY]
        p = p + v * dt + 0.5 * acceleration * dt**2
        v = v + acceleration * dt
        R = R @ so3_exp(rate * dt)
    assert np.linalg.norm(p - truth.position(22.0)) < INS_POSITION_M
    assert np.linalg.norm(so3_log(R @ truth.rotation(22.0).T)) < INS_ATTITUDE_RAD


def test_velocity_acceleration_and_rate_are_derivatives_of_the_pose(truth: Trajectory) -> None:
    t, h = np.linspace(0.1, 22.0, 50), 1e-4
    velocity = (truth.position(t + h) - truth.position(t - h)) / (2 * h)
    acceleration = (truth.velocity(t + h) - truth.velocity(t - h)) / (2 * h)
    R_before, R_after = truth.rotation(t - h), truth.rotation(t + h)
    rate = so3_log(np.swapaxes(R_before, -1, -2) @ R_after) / (2 * h)
    np.testing.assert_allclose(truth.velocity(t), velocity, atol=1e-5)
    np.testing.assert_allclose(truth.acceleration(t), acceleration, atol=1e-4)
    np.testing.assert_allclose(truth.angular_rate_body(t), rate, atol=1e-4)


def test_queries_take_scalars_and_empty_arrays(truth: Trajectory) -> None:
    assert truth.pose(1.0).R.shape == (3, 3)
    assert truth.position(np.zeros(0)).shape == (0, 3)
    assert truth.specific_force_body(np.zeros(0), gravity=GRAVITY).shape == (0, 3)


@pytest.mark.parametrize("pattern", sorted(PATTERNS))
def test_turns_are_coordinated_and_bank_into_the_turn(pattern: str) -> None:
    truth = smooth_flight(pattern)
    t = np.linspace(0.0, 60.0, 601)
    force, rate = truth.specific_force_body(t, gravity=GRAVITY), truth.angular_rate_body(t)
    assert np.abs(force[:, 1]).max() < 0.1  # no side force
    assert np.abs(rate[:, 2]).max() > 0.05  # it does turn
    body_y_up = truth.rotation(t)[:, 2, 1]
    turning = np.abs(rate[:, 2]) > 0.05
    assert np.all(np.sign(body_y_up[turning]) == -np.sign(rate[turning, 2]))  # left wing low in a left turn


@pytest.mark.parametrize("pattern", sorted(PATTERNS))
def test_speed_and_height_are_as_configured(pattern: str) -> None:
    truth = smooth_flight(pattern)
    t = np.linspace(0.0, 60.0, 301)
    np.testing.assert_allclose(np.linalg.norm(truth.velocity(t), axis=1), 20.0, atol=0.05)
    np.testing.assert_allclose(truth.position(t)[:, 2], 70.0, atol=1e-6)


def test_lawnmower_legs_are_one_spacing_apart() -> None:
    truth = smooth_flight("lawnmower", 60.0)
    t = np.linspace(0.0, 60.0, 3001)
    west = t[np.cos(np.unwrap(np.arctan2(*truth.velocity(t).T[1::-1]))) < -0.9999]
    assert np.median(truth.position(west)[:, 1]) == pytest.approx(25.0, abs=5.0)
