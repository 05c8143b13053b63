# SPDX-License-Identifier: Apache-2.0
"""An IMU elsewhere on the body, turned against it, tells the same motion as one at its origin."""

import numpy as np

from uav_vslam.config import IMU_GRADES
from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.rotation import so3_exp
from uav_vslam.ins.alignment import static_alignment
from uav_vslam.ins.mounting import ImuMounting
from uav_vslam.ins.white_noise import SEGMENT, WhiteNoise
from uav_vslam.types import NS_PER_S, ImuSample

RATE_HZ = 400
ARM_BODY_M = np.array([0.3, -0.1, 0.05])
MOUNTED = Pose(so3_exp([3.0, 0.2, -0.4]), ARM_BODY_M)


def rate(t: float) -> np.ndarray:
    return np.array([0.8 * np.sin(3 * t), 0.5 * np.cos(2 * t), 0.3 + 0.4 * np.sin(t)])


def rate_change(t: float) -> np.ndarray:
    return np.array([2.4 * np.cos(3 * t), -np.sin(2 * t), 0.4 * np.cos(t)])


def force(t: float) -> np.ndarray:
    return np.array([np.sin(t), 0.2, 9.8])


def at_arm(t: float) -> ImuSample:
    w = rate(t)
    felt = force(t) + np.cross(rate_change(t), ARM_BODY_M) + np.cross(w, np.cross(w, ARM_BODY_M))
    return ImuSample(round(t * NS_PER_S), MOUNTED.R.T @ w, MOUNTED.R.T @ felt)


def test_readings_at_a_lever_arm_become_those_of_the_body() -> None:
    """The difference of successive rates is that of half a period earlier: 3 rad/s^3 of jerk over 1.25 ms and 0.3 m."""
    mounting = ImuMounting(MOUNTED)
    times = np.arange(0.0, 3.0, 1.0 / RATE_HZ)
    moved = [mounting.to_body(at_arm(t)) for t in times]
    np.testing.assert_allclose([one.gyro for one in moved], [rate(t) for t in times], atol=1e-12)
    np.testing.assert_allclose([one.accel for one in moved[1:]], [force(t) for t in times[1:]], atol=4e-3)


def test_noise_of_the_rate_leaves_a_velocity_error_that_does_not_grow() -> None:
    """dw/dt x l integrates to (w_end - w_start) x l, whatever the noise in between."""
    rng = np.random.default_rng(1)
    mounting = ImuMounting(Pose(np.eye(3), ARM_BODY_M))
    noise = 0.01 * rng.standard_normal((4000, 3))
    felt = [mounting.to_body(ImuSample(k * NS_PER_S // RATE_HZ, w, np.zeros(3))).accel for k, w in enumerate(noise)]
    centripetal = np.array([np.cross(w, np.cross(w, ARM_BODY_M)) for w in noise])
    velocity = np.cumsum(np.array(felt) + centripetal, axis=0) / RATE_HZ
    np.testing.assert_allclose(velocity, -np.cross(noise - noise[0], ARM_BODY_M), atol=1e-9)


def test_an_imu_at_the_origin_keeps_every_bit() -> None:
    reading = ImuSample(1, np.array([0.1, 0.2, 0.3]), np.array([1.0, 2.0, 3.0]))
    assert ImuMounting(Pose.identity()).to_body(reading) is reading


def test_a_long_lever_arm_neither_looks_like_noise_nor_like_motion() -> None:
    """The noise of dw/dt x l, 4 m/s^2 here, is the gyroscope's: an IMU at rest rests, and is no noisier than it is."""
    rng, imu = np.random.default_rng(2), IMU_GRADES["consumer"]
    mounting, noise, moved = ImuMounting(Pose(MOUNTED.R, np.array([0.6, -0.6, 0.5]))), WhiteNoise(imu), []
    up_imu = MOUNTED.R.T @ [0.0, 0.0, imu.gravity]
    for k in range(10 * SEGMENT):
        gyro, accel = (
            density * np.sqrt(RATE_HZ) * rng.standard_normal(3) for density in (imu.gyro_noise, imu.accel_noise)
        )
        moved.append(mounting.to_body(ImuSample(k * NS_PER_S // RATE_HZ, gyro, up_imu + accel)))
        noise.add(moved[-1], 1.0 / RATE_HZ)
        assert noise.imu is imu
    assert np.array([one.accel for one in moved]).std(axis=0).max() > 3.0
    up = static_alignment(moved, moved[-1].stamp_ns, imu).state.T_map_body.R[2]
    np.testing.assert_allclose(up, [0.0, 0.0, 1.0], atol=2e-3)
