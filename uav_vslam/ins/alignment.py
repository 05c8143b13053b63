# SPDX-License-Identifier: Apache-2.0
"""Start states levelled by gravity; their position and heading define the map frame.

At rest the accelerometer measures gravity and the gyroscope its bias. In flight: `slam.in_flight_initializer`.
"""

import numpy as np
from numpy.typing import NDArray

from uav_vslam.config import ImuConfig
from uav_vslam.errors import UavVslamError
from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.rotation import rotation_from_rpy
from uav_vslam.ins.propagation import ACCEL_BIAS
from uav_vslam.types import ImuSample, NavEstimate, NavState

Array = NDArray[np.float64]

MAX_RATE_STD = 0.05  # [rad/s] largest gyroscope noise at rest
MAX_ACCEL_STD = 0.5  # [m/s^2] largest accelerometer noise at rest
MAX_RATE_BIAS = 0.35  # [rad/s] largest of usual gyroscopes, 20 deg/s; more is a steady turn
MOST_FORCE = 2.0  # times gravity, the mean force of a turn at 60 degrees of bank; its inverse is the least
SIGMA_ORIGIN_M = 1e-3  # position and heading define the frame, so are known
SIGMA_HEADING_RAD = 1e-3
SIGMA_REST = 1e-2  # [m/s]
MOST_SIGMAS = 3.0  # of the accelerometer's bias along gravity at rest


def static_alignment(samples: list[ImuSample], stamp_ns: int, imu: ImuConfig) -> NavEstimate:
    """Return the state of a vehicle at rest, at the origin; see `levelled`.

    Args:
        samples: readings at rest, a second or more.
        stamp_ns: time of the state [ns].
        imu: noise, gravity and bias uncertainty.

    Raises:
        UavVslamError: too few readings, or the vehicle moves, or they can't be of gravity.
    """
    gyro, accel = np.array([s.gyro for s in samples]), np.array([s.accel_at_imu for s in samples])
    if len(samples) < 10:
        raise UavVslamError(
            f"static alignment needs a second of IMU readings before the first frame, got {len(samples)}"
        )
    force = float(np.linalg.norm(accel.mean(axis=0)))
    if unlike := unlike_gravity(force, imu):
        raise UavVslamError(unlike)
    rate_std, accel_std = float(gyro.std(axis=0).max()), float(accel.std(axis=0).max())
    if rate_std > MAX_RATE_STD or accel_std > MAX_ACCEL_STD:
        raise UavVslamError(
            f"the vehicle moves (gyro {rate_std:.3f} rad/s, accelerometer {accel_std:.2f} m/s^2 rms): static alignment "
            "needs rest; set start.method: in_flight, or give an initial_state"
        )
    if (rate := float(np.linalg.norm(gyro.mean(axis=0)))) > MAX_RATE_BIAS:
        raise UavVslamError(
            f"the vehicle turns at {rate:.2f} rad/s, more than a gyroscope's bias: static alignment needs rest; set "
            "start.method: in_flight, or check the gyroscope's unit (rad/s)"
        )
    bias = abs(force - imu.gravity)  # along gravity; what is across tilts the start
    sigma_accel_bias = bias if bias > MOST_SIGMAS * imu.accel_bias_sigma else imu.accel_bias_sigma
    return levelled(
        stamp_ns,
        up_body=accel.mean(axis=0),
        v_body=np.zeros(3),
        gyro_bias=gyro.mean(axis=0),
        sigma_velocity=SIGMA_REST,
        sigma_tilt=sigma_accel_bias / imu.gravity,  # neglecting their correlation is conservative
        sigma_gyro_bias=max(MAX_RATE_STD / np.sqrt(len(samples)) * 0.1, 10 * imu.gyro_bias_walk),
        sigma_accel_bias=sigma_accel_bias,
    )


def biased_rest(start: NavEstimate, imu: ImuConfig) -> str:
    """Return what a start at rest has found of the accelerometer's bias; empty if it is as configured."""
    sigma = float(np.sqrt(start.covariance[ACCEL_BIAS, ACCEL_BIAS][0, 0]))
    if sigma <= imu.accel_bias_sigma:
        return ""
    return (
        f"at rest the accelerometer is {sigma:.2g} m/s^2 off gravity ({imu.gravity:g} m/s^2), "
        f"{sigma / imu.accel_bias_sigma:.1f} times imu.accel_bias_sigma; the start allows for it: set "
        f"imu.accel_bias_sigma: {sigma:.2g}, or calibrate the accelerometer"
    )


def unlike_gravity(force: float, imu: ImuConfig) -> str:
    """Return what is wrong with the mean specific force of a start [m/s^2]; empty if it may be a vehicle's."""
    if imu.gravity / MOST_FORCE < force < imu.gravity * MOST_FORCE:
        return ""
    return (
        f"the accelerometer measures {force:.3g} m/s^2, where gravity is {imu.gravity:.3g}: check its unit and scale; "
        "if it has a topic of its own, set input.topics.accel for recordings, and have a live driver unite it with the "
        "gyroscope (RealSense: unite_imu_method: 2)"
    )


def levelled(
    stamp_ns: int,
    *,
    up_body: Array,
    v_body: Array,
    gyro_bias: Array,
    sigma_velocity: float,
    sigma_tilt: float,
    sigma_gyro_bias: float,
    sigma_accel_bias: float,
) -> NavEstimate:
    """Return a state at the origin, with yaw 0 and with roll and pitch such that `up_body` points up.

    Its heading defines the map: true is what is turned from it about horizontal axes alone. A yaw as angle could not
    define it, as EuRoC's vehicle has its x axis up.

    Args:
        stamp_ns: time of the state [ns].
        up_body: (3,) direction opposite to gravity, any norm.
        v_body: (3,) velocity in the body frame [m/s].
        gyro_bias: (3,) [rad/s]; the accelerometer's is zero.
        sigma_velocity, sigma_tilt, sigma_gyro_bias, sigma_accel_bias: standard deviations per axis [m/s], [rad],
            [rad/s], [m/s^2].
    """
    x, y, z = up_body / np.linalg.norm(up_body)
    roll, pitch = float(np.arctan2(y, z)), float(-np.arcsin(np.clip(x, -1.0, 1.0)))
    R_map_body = rotation_from_rpy(roll, pitch, 0.0)
    state = NavState(stamp_ns, Pose(R_map_body, np.zeros(3)), R_map_body @ v_body, gyro_bias, np.zeros(3))
    sigma = np.repeat([SIGMA_ORIGIN_M, sigma_velocity, SIGMA_HEADING_RAD, sigma_gyro_bias, sigma_accel_bias], 3)
    sigma[6:8] = sigma_tilt
    return NavEstimate(state, np.diag(sigma**2))
