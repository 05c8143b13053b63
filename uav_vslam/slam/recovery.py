# SPDX-License-Identifier: Apache-2.0
"""What a filter goes on from after it has been lost, has lost its positive definiteness, or was started wrongly.

The covariance of a lost one is inflated, but not without bound: recoveries may follow each other, and a factor at each
of them makes an estimate that no filter can work with, which fails again at once, and so on.
"""

import dataclasses

import numpy as np
from numpy.typing import NDArray

from uav_vslam.config import ImuConfig
from uav_vslam.errors import FilterDivergence
from uav_vslam.ins.increments import MOST_ROTATION_SIGMA, UNKNOWN_SPEED_SIGMA, unknown_motion_since
from uav_vslam.ins.preintegrator import advance
from uav_vslam.ins.propagation import ACCEL_BIAS, GYRO_BIAS, NAV_DIM, POSITION, ROTATION, VELOCITY
from uav_vslam.numerics import cholesky, symmetrise
from uav_vslam.types import NS_PER_S, ImuIncrement, NavEstimate

Array = NDArray[np.float64]

INFLATION = 4.0  # of the covariance
# [m] per axis. Far below 10 km, where the information about a position is lost beside that of past poses about each
# other (`past_poses.COPY_VARIANCE`) in the rounding of their sum.
MOST_POSITION_SIGMA = 1000.0
# By how many times its sigmas a start that the first frames contradict may be off: position, which defines the map,
# velocity, tilt, heading, biases. A wider tilt would be linearised too far from the truth where landmarks are noisy.
START_INFLATION = np.repeat([1.0, 10.0, 3.0, 10.0, 3.0], [3, 3, 2, 1, 6])
UNAIDED_S = 1.0  # a vibration from the start on is noticed by then
TURNED_RAD = 0.005  # 1 sigma of the rotation over a few frames, by rates of an IMU whose accelerations are wrong


class Fallbacks:
    """Estimates of the present that faulty images, or a faulty IMU, have not spoilt.

    Attributes:
        unaided: what the filter began with, propagated by the IMU alone; None once it has drifted for `UNAIDED_S`.
        began_ns: when that was [ns].
    """

    def __init__(self, initial: NavEstimate) -> None:
        self.confirm(initial)
        self.begin(initial)

    def begin(self, initial: NavEstimate) -> None:
        """Start over with what a filter begins with."""
        self.unaided: NavEstimate | None = initial
        self.began_ns = initial.state.stamp_ns

    def propagate(self, increment: ImuIncrement, imu: ImuConfig) -> None:
        """Propagate the unaided estimate to the next frame."""
        if self.unaided is not None:
            is_recent = increment.stamp_ns - self.began_ns <= UNAIDED_S * NS_PER_S
            self.unaided = advance(self.unaided, increment, imu) if is_recent else None

    def confirm(self, estimate: NavEstimate) -> None:
        """Take over an estimate that an image has confirmed."""
        self._confirmed = estimate

    def without_readings(self, now: NavEstimate, imu: ImuConfig, *, is_gyro_healthy: bool) -> NavEstimate:
        """Return the present estimate as if the readings since the last confirmed one had been missing.

        Args:
            now: the estimate by these readings.
            imu: noise.
            is_gyro_healthy: whether their angular rates count nevertheless.
        """
        before = self._confirmed
        unknown = unknown_motion_since(before.state, now.state.stamp_ns, imu)
        if is_gyro_healthy:
            covariance = unknown.covariance.copy()
            covariance[:3, :3] = TURNED_RAD**2 * np.eye(3)
            turned = before.state.T_map_body.R.T @ now.state.T_map_body.R
            unknown = dataclasses.replace(unknown, delta_R=turned, covariance=covariance)
        return advance(before, unknown, imu)


def reinitialised(estimate: NavEstimate, *, since_s: float, imu: ImuConfig) -> NavEstimate:
    """Return an estimate with an inflated covariance.

    No axis becomes more uncertain than if nothing had been known of velocity, attitude and biases; the position, than
    if it had gone wrong at that velocity ever since the filter was initialised.

    Args:
        estimate: the last one, with a covariance that may have lost its positive definiteness.
        since_s: time since the filter was initialised [s].
        imu: its bias uncertainty.
    """
    P = INFLATION * symmetrise(estimate.covariance)
    variance = np.where(np.isfinite(np.diagonal(P)), np.maximum(np.diagonal(P), 0.0), np.inf)
    most = _most_variance(estimate, since_s, imu)
    scale = np.sqrt(np.minimum(1.0, most / np.maximum(variance, np.finfo(float).tiny)))
    bounded = P * scale[:, None] * scale
    try:
        cholesky(bounded, "covariance")
    except FilterDivergence:  # its correlations mean nothing any more
        bounded = np.diag(np.where(variance > 0.0, np.minimum(variance, most), most))
    return NavEstimate(estimate.state, bounded)


def doubted_start(initial: NavEstimate) -> NavEstimate:
    """Return a start state that the first frames contradict, with a covariance that allows for it.

    Nothing is known of the speed: a vehicle that is said to be at rest may fly. The direction of a velocity is as wrong
    as its inflated sigmas allow, so it still tells the heading; at rest there is none.
    """
    P = initial.covariance * START_INFLATION[:, None] * START_INFLATION
    v, most = initial.state.v_map, float(np.linalg.eigvalsh(P[VELOCITY, VELOCITY])[-1])
    speed2 = max(float(v @ v), most)
    along = np.outer(v, v) / speed2
    P[VELOCITY, VELOCITY] += UNKNOWN_SPEED_SIGMA**2 * (along + most / speed2 * (np.eye(3) - along))
    return NavEstimate(initial.state, P)


def _most_variance(estimate: NavEstimate, since_s: float, imu: ImuConfig) -> Array:
    """Return (15,) the variance of an estimate of which nothing is known: its own mean may be as far off as it goes."""
    state, most = estimate.state, np.zeros(NAV_DIM)
    most[VELOCITY] = UNKNOWN_SPEED_SIGMA**2 + state.v_map @ state.v_map
    most[ROTATION] = MOST_ROTATION_SIGMA**2
    most[GYRO_BIAS] = imu.gyro_bias_sigma**2 + state.gyro_bias @ state.gyro_bias
    most[ACCEL_BIAS] = imu.accel_bias_sigma**2 + state.accel_bias @ state.accel_bias
    drifted = np.diagonal(estimate.covariance)[POSITION] + most[VELOCITY] * since_s**2
    most[POSITION] = np.fmin(drifted, MOST_POSITION_SIGMA**2)
    return most
