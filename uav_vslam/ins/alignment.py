# SPDX-License-Identifier: Apache-2.0
"""A start state for a vehicle at rest: gravity gives the tilt, the gyroscope its own bias; the start is the origin."""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from uav_vslam.config import ImuConfig
from uav_vslam.errors import UavVslamError
from uav_vslam.geometry.pose import Pose
from uav_vslam.types import ImuSample, NavEstimate, NavState

Array = NDArray[np.float64]

MAX_RATE_STD = 0.05  # [rad/s] above it the vehicle is not at rest
MAX_ACCEL_STD = 0.5  # [m/s^2] likewise
SIGMA_ORIGIN_M = 1e-3  # position and yaw define the frame: they are known by definition
SIGMA_YAW_RAD = 1e-3
SIGMA_REST = 1e-2  # [m/s]


def static_alignment(samples: list[ImuSample], stamp_ns: int, imu: ImuConfig) -> NavEstimate:
    """Return the state of a resting vehicle, at the origin and facing east.

    Args:
        samples: readings at rest, a second or more.
        stamp_ns: time of the state [ns].
        imu: noise, gravity and how well the biases are known.

    Raises:
        UavVslamError: there are too few readings, or the vehicle moved.
    """
    gyro, accel = np.array([s.gyro for s in samples]), np.array([s.accel for s in samples])
    if len(samples) < 10:
        raise UavVslamError(
            f"static alignment needs a second of IMU readings before the first frame, got {len(samples)}"
        )
    rate_std, accel_std = float(gyro.std(axis=0).max()), float(accel.std(axis=0).max())
    if rate_std > MAX_RATE_STD or accel_std > MAX_ACCEL_STD:
        raise UavVslamError(
            f"the vehicle moves (gyro {rate_std:.3f} rad/s, accelerometer {accel_std:.2f} m/s^2 rms): static alignment "
            "needs rest; give an initial_state instead"
        )
    up_body = accel.mean(axis=0)
    up_body /= np.linalg.norm(up_body)
    roll, pitch = np.arctan2(up_body[1], up_body[2]), -np.arcsin(np.clip(up_body[0], -1.0, 1.0))
    R_map_body = Rotation.from_euler("ZYX", [0.0, pitch, roll]).as_matrix()
    state = NavState(stamp_ns, Pose(R_map_body, np.zeros(3)), np.zeros(3), gyro.mean(axis=0), np.zeros(3))
    return NavEstimate(state, _covariance(len(samples), imu))


def _covariance(count: int, imu: ImuConfig) -> Array:
    """Tilt as uncertain as the accelerometer bias makes it; their correlation is left out, which is the safe side."""
    sigma_tilt = imu.accel_bias_sigma / imu.gravity
    sigma_gyro_bias = max(MAX_RATE_STD / np.sqrt(count) * 0.1, 10 * imu.gyro_bias_walk)
    sigma = np.repeat([SIGMA_ORIGIN_M, SIGMA_REST, sigma_tilt, sigma_gyro_bias, imu.accel_bias_sigma], 3)
    sigma[8] = SIGMA_YAW_RAD
    return np.diag(sigma**2)
