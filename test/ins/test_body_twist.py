# SPDX-License-Identifier: Apache-2.0
import dataclasses

import numpy as np
import pytest

from uav_vslam.config import ImuConfig
from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.rotation import so3_exp
from uav_vslam.ins.body_twist import body_twist
from uav_vslam.ins.gaps import UNKNOWN_RATE_SIGMA
from uav_vslam.ins.preintegration import preintegrate
from uav_vslam.types import ImuSample, NavEstimate, NavState

IMU = ImuConfig(gyro_noise=1e-3)
RATE, BIAS = np.array([0.1, -0.3, 0.2]), np.array([0.01, 0.02, -0.03])
STATE = NavState(
    100_000_000, Pose(so3_exp(np.array([0.2, -0.4, 1.0])), np.zeros(3)), np.array([20.0, -3.0, 1.0]), BIAS, np.zeros(3)
)


def increment(period_ns: int):
    samples = [
        ImuSample(k * period_ns, RATE + BIAS, np.array([0.0, 0.0, 9.8])) for k in range(100_000_000 // period_ns + 1)
    ]
    return preintegrate(samples, 0, 100_000_000, gyro_bias=np.zeros(3), accel_bias=np.zeros(3), imu=IMU)


def covariance() -> np.ndarray:
    A = np.random.default_rng(3).normal(size=(15, 15))
    return 1e-6 * (A @ A.T + 15 * np.eye(15))


def test_velocity_and_rate_are_in_the_body_frame_without_the_bias() -> None:
    twist = body_twist(NavEstimate(STATE, covariance()), increment(5_000_000))
    np.testing.assert_allclose(STATE.T_map_body.R @ twist.linear, STATE.v_map, atol=1e-12)
    np.testing.assert_allclose(twist.angular, RATE, atol=1e-12)


@pytest.mark.slow
def test_the_covariance_is_that_of_drawn_errors() -> None:
    """Truth is drawn around the estimate; 3 % is four standard deviations of 40 000 draws' variances."""
    rng, P = np.random.default_rng(5), covariance()
    twist = body_twist(NavEstimate(STATE, P), increment(5_000_000))
    errors = []
    for draw in rng.multivariate_normal(np.zeros(15), P, size=40_000):
        true_R = so3_exp(draw[6:9]) @ STATE.T_map_body.R
        white = IMU.gyro_noise * np.sqrt(200.0) * rng.normal(size=3)
        errors.append(np.concatenate([true_R.T @ (STATE.v_map + draw[3:6]) - twist.linear, -draw[9:12] + white]))
    drawn = np.cov(np.array(errors).T)
    scale = np.sqrt(np.diag(twist.covariance))
    np.testing.assert_allclose(drawn / np.outer(scale, scale), twist.covariance / np.outer(scale, scale), atol=0.03)


def test_a_slower_imu_is_less_noisy_per_reading() -> None:
    estimate = NavEstimate(STATE, 1e-12 * np.eye(15))
    fast, slow = (body_twist(estimate, increment(ns)).covariance[3, 3] for ns in (5_000_000, 10_000_000))
    assert fast == pytest.approx(2 * slow, rel=1e-3)


def test_without_readings_the_rate_is_unknown() -> None:
    estimate = NavEstimate(STATE, covariance())
    empty = dataclasses.replace(increment(5_000_000), samples=0)
    for motion in (None, empty):
        twist = body_twist(estimate, motion)
        assert twist.covariance[4, 4] >= UNKNOWN_RATE_SIGMA**2
        np.testing.assert_array_equal(twist.angular, np.zeros(3))
