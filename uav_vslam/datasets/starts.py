# SPDX-License-Identifier: Apache-2.0
"""Start states within a recording: the truth at a stamp, and errors drawn from a start's covariance."""

import dataclasses

import numpy as np
from numpy.typing import NDArray

from uav_vslam.config import ImuConfig
from uav_vslam.errors import UavVslamError
from uav_vslam.evaluation.pairing import MAX_GAP_S
from uav_vslam.evaluation.trajectory import Trajectory, interpolate
from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.rotation import so3_exp
from uav_vslam.ins.propagation import ACCEL_BIAS, GYRO_BIAS, POSITION, ROTATION, VELOCITY
from uav_vslam.types import NS_PER_S, NavEstimate, NavState

Array = NDArray[np.float64]

SIGMA_POSITION_M, SIGMA_VELOCITY = 0.05, 0.1  # per axis, as `uav-vslam simulate` starts its vehicles
SIGMA_TILT_DEG, SIGMA_YAW_DEG = 0.2, 0.5


def true_start(
    truth: Trajectory, velocities_world: Array, stamp_ns: int, recorded: NavEstimate | None, imu: ImuConfig
) -> NavEstimate:
    """Return the true pose and velocity at a stamp, with the uncertainty of the recorded start.

    No recording holds true biases: they are those of the recorded start, with the variance of their walk in between.

    Args:
        truth: true poses.
        velocities_world: (N, 3) true velocity at each of them [m/s].
        stamp_ns: where [ns].
        recorded: the recorded start; without one, biases are zero and the uncertainty is that of simulated starts.
        imu: noise.

    Raises:
        UavVslamError: there is no truth at the stamp.
    """
    pose, rows = interpolate(truth, np.array([stamp_ns], np.int64), max_gap_s=MAX_GAP_S)
    if len(rows) == 0:
        raise UavVslamError(f"no truth at {stamp_ns} ns, where a flight should start")
    since_ns = truth.stamps_ns - stamp_ns
    velocity = np.array([np.interp(0.0, since_ns, component) for component in velocities_world.T])
    before = recorded or _unknown(stamp_ns, imu)
    dt_s = abs(stamp_ns - before.state.stamp_ns) / NS_PER_S  # a leg may begin before the recorded start
    P = before.covariance.copy()
    P[GYRO_BIAS, GYRO_BIAS] += imu.gyro_bias_walk**2 * dt_s * np.eye(3)
    P[ACCEL_BIAS, ACCEL_BIAS] += imu.accel_bias_walk**2 * dt_s * np.eye(3)
    T_map_body = Pose(pose.rotations[0], pose.positions[0])
    return NavEstimate(NavState(stamp_ns, T_map_body, velocity, before.state.gyro_bias, before.state.accel_bias), P)


def drawn_start(centre: NavEstimate, rng: np.random.Generator, *, biases: bool = True) -> NavEstimate:
    """Return an estimate whose error, if the truth is at the centre, is drawn from the centre's covariance.

    Args:
        centre: the true start.
        rng: draws the error.
        biases: give the biases errors too; not where the centre's are estimates already.

    Raises:
        UavVslamError: the covariance is not positive definite.
    """
    try:
        root = np.linalg.cholesky(centre.covariance)
    except np.linalg.LinAlgError:
        raise UavVslamError(
            f"the covariance of the start state at {centre.state.stamp_ns} ns is not positive definite; record an "
            "initial_state whose variances, those of the biases too, are above zero"
        ) from None
    error = root @ rng.standard_normal(len(centre.covariance))
    state, T = centre.state, centre.state.T_map_body
    moved = dataclasses.replace(
        state,
        T_map_body=Pose(so3_exp(-error[ROTATION]) @ T.R, T.t - error[POSITION]),
        v_map=state.v_map - error[VELOCITY],
        gyro_bias=state.gyro_bias - error[GYRO_BIAS] * biases,
        accel_bias=state.accel_bias - error[ACCEL_BIAS] * biases,
    )
    return NavEstimate(moved, centre.covariance)


def _unknown(stamp_ns: int, imu: ImuConfig) -> NavEstimate:
    """Return a start without biases, as uncertain as a simulated one; its pose and velocity mean nothing."""
    tilt, yaw = np.deg2rad([SIGMA_TILT_DEG, SIGMA_YAW_DEG])
    sigma = np.repeat([SIGMA_POSITION_M, SIGMA_VELOCITY, 0.0, imu.gyro_bias_sigma, imu.accel_bias_sigma], 3)
    sigma[ROTATION] = tilt, tilt, yaw
    state = NavState(stamp_ns, Pose.identity(), np.zeros(3), np.zeros(3), np.zeros(3))
    return NavEstimate(state, np.diag(sigma**2))
