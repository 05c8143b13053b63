# SPDX-License-Identifier: Apache-2.0
"""Increments once they are made: composed, extended over time without readings, and judged by what they lack."""

import numpy as np
from numpy.typing import NDArray

from uav_vslam.config import ImuConfig
from uav_vslam.geometry.rotation import skew
from uav_vslam.ins.gaps import LEAP_S, UNKNOWN_ACCEL_SIGMA, UNKNOWN_RATE_SIGMA
from uav_vslam.types import NS_PER_S, ImuIncrement, NavState

Array = NDArray[np.float64]

LACKING = 10.0  # standard deviations of complete readings: one reading in ten is missing at 4, half of them at 15
UNKNOWN_SPEED_SIGMA = 15.0  # [m/s] per axis, over a leap: a clock that was set took the vehicle nowhere
MOST_ROTATION_SIGMA = np.pi / np.sqrt(3.0)  # [rad] of an angle of which nothing is known


def compose(first: ImuIncrement, second: ImuIncrement) -> ImuIncrement:
    """Return the motion over two adjacent intervals, equal to one preintegration over both.

    dR = dR1 dR2, dv = dv1 + dR1 dv2, dp = dp1 + dv1 dt2 + dR1 dp2; Jacobian and covariance follow to first order.

    Raises:
        ValueError: the second does not start where the first ends, or they are linearised at different biases.
    """
    if second.start_ns != first.stamp_ns:
        raise ValueError(f"an increment from {second.start_ns} ns does not follow one to {first.stamp_ns} ns")
    before, after = (np.concatenate([one.gyro_bias, one.accel_bias]) for one in (first, second))
    if not np.array_equal(before, after):
        raise ValueError(f"adjacent increments at {first.stamp_ns} ns are linearised at different biases")
    A, B = error_transfer(first, second)
    return ImuIncrement(
        start_ns=first.start_ns,
        stamp_ns=second.stamp_ns,
        samples=first.samples + second.samples,
        delta_R=first.delta_R @ second.delta_R,
        delta_v=first.delta_v + first.delta_R @ second.delta_v,
        delta_p=first.delta_p + first.delta_v * second.dt_s + first.delta_R @ second.delta_p,
        rate_start=first.rate_start,
        rate_end=second.rate_end,
        rate_slope_start=first.rate_slope_start,
        rate_slope_end=second.rate_slope_end,
        gyro_bias=first.gyro_bias,
        accel_bias=first.accel_bias,
        bias_jacobian=A @ first.bias_jacobian + B @ second.bias_jacobian,
        covariance=A @ first.covariance @ A.T + B @ second.covariance @ B.T,
        gyro_noise=max(first.gyro_noise, second.gyro_noise),
        accel_noise=max(first.accel_noise, second.accel_noise),
    )


def error_transfer(first: ImuIncrement, second: ImuIncrement) -> tuple[Array, Array]:
    """Return A, B (9, 9): Jacobians of the composed error (rotation, velocity, position) by those of both parts."""
    R, dt = first.delta_R, second.dt_s
    A, B = np.eye(9), np.eye(9)
    A[0:3, 0:3] = second.delta_R.T
    A[3:6, 0:3] = -R @ skew(second.delta_v)
    A[6:9, 0:3] = -R @ skew(second.delta_p)
    A[6:9, 3:6] = dt * np.eye(3)
    B[3:6, 3:6] = B[6:9, 6:9] = R
    return A, B


def bridged(increment: ImuIncrement, start_ns: int, imu: ImuConfig) -> ImuIncrement:
    """Extend an increment back to an earlier stamp, if it does not start there; the motion in between is unknown.

    Args:
        increment: known part of the motion.
        start_ns: start of the result, not after the increment's [ns].
        imu: gravity and noise; the unknown part is a hover.
    """
    if increment.start_ns == start_ns:
        return increment
    bias = {"gyro_bias": increment.gyro_bias, "accel_bias": increment.accel_bias}
    unknown = unknown_motion(start_ns, increment.start_ns, **bias, imu=imu)
    return compose(unknown, increment)


def unknown_motion(
    start_ns: int, stamp_ns: int, *, gyro_bias: Array, accel_bias: Array, imu: ImuConfig
) -> ImuIncrement:
    """Return a hover with a very large covariance, for a time without readings.

    Over more than LEAP_S its covariance also allows for a vehicle that has not moved at all: a jump of the clock looks
    the same as a silence.

    Args:
        start_ns, stamp_ns: the interval [ns].
        gyro_bias, accel_bias: (3,) linearisation point [rad/s], [m/s^2].
        imu: gravity and noise.
    """
    dt = (stamp_ns - start_ns) / NS_PER_S
    hover = np.array([0.0, 0.0, imu.gravity])
    moved_m = np.hypot(0.5 * UNKNOWN_ACCEL_SIGMA * dt**2, UNKNOWN_SPEED_SIGMA * dt if dt > LEAP_S else 0.0)
    turned_rad = min(UNKNOWN_RATE_SIGMA * dt, MOST_ROTATION_SIGMA)
    sigma = np.repeat([turned_rad, UNKNOWN_ACCEL_SIGMA * dt, moved_m], 3)
    return ImuIncrement(
        start_ns=start_ns,
        stamp_ns=stamp_ns,
        samples=0,
        delta_R=np.eye(3),
        delta_v=hover * dt,
        delta_p=0.5 * hover * dt**2,
        rate_start=np.array(gyro_bias, dtype=float),
        rate_end=np.array(gyro_bias, dtype=float),
        rate_slope_start=np.zeros(3),
        rate_slope_end=np.zeros(3),
        gyro_bias=np.array(gyro_bias, dtype=float),
        accel_bias=np.array(accel_bias, dtype=float),
        bias_jacobian=np.zeros((9, 6)),
        covariance=np.diag(sigma**2),
        gyro_noise=imu.gyro_noise,
        accel_noise=imu.accel_noise,
    )


def unknown_motion_since(state: NavState, stamp_ns: int, imu: ImuConfig) -> ImuIncrement:
    """Return the unknown motion from a state to a stamp [ns], linearised at the state's bias; see `unknown_motion`."""
    bias = {"gyro_bias": state.gyro_bias, "accel_bias": state.accel_bias}
    return unknown_motion(state.stamp_ns, stamp_ns, **bias, imu=imu)


def lacks_readings(increment: ImuIncrement) -> bool:
    """Return whether so many readings are missing that the rotation is known far worse than the gyroscope's noise."""
    return bool(np.trace(increment.covariance[:3, :3]) > LACKING**2 * 3.0 * increment.gyro_noise**2 * increment.dt_s)
