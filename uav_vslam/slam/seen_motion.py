# SPDX-License-Identifier: Apache-2.0
"""The motion between two frames as their tracks show it, where readings of the IMU are missing.

A filter that is linearised at a motion of which nothing is known claims what it can't know. So the motion is found by
PnP first. That is no measurement: the increment made of it is so uncertain that the same tracks, observed afterwards,
decide.
"""

import dataclasses
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from uav_vslam.config import ImuConfig
from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.rotation import so3_log
from uav_vslam.geometry.stereo import StereoRig
from uav_vslam.ins.gaps import LEAP_S, UNKNOWN_RATE_SIGMA
from uav_vslam.ins.increments import MOST_ROTATION_SIGMA, UNKNOWN_SPEED_SIGMA, unknown_motion_since
from uav_vslam.slam.imu_fault import ImuFaultDetector
from uav_vslam.types import ImuIncrement, NavState, StereoFeatures
from uav_vslam.vision.pnp import pnp_ransac

Rows = NDArray[np.intp]

# Shares of the standard deviation of an unknown rotation,
SEEN_BEYOND = 0.05  # beyond which the images know better,
COAST_BEYOND = 0.5  # and beyond which they are of no use without PnP
MIN_INLIERS = 12
FLAT_POSITION_SIGMA = 100.0  # [m] as good as unknown, and little enough for information form
FLAT_ROTATION_SIGMA = 1.0  # [rad]


@dataclass(frozen=True, slots=True)
class Step:
    """A frame and the motion up to it.

    Attributes:
        increment: None only for a frame at the start state.
        features: those that the filter may use.
        tracks: number of tracks that have shown the motion; 0 if it is the IMU's.
        apart_rad: angle between the rotations of IMU and tracks [rad]; None if these were not asked, or show none.
    """

    increment: ImuIncrement | None
    features: StereoFeatures
    tracks: int = 0
    apart_rad: float | None = None


class MotionFinder:
    """Looks for the motion of each frame since the one before, if the IMU does not know it."""

    def __init__(self) -> None:
        self._before: StereoFeatures | None = None

    def step(
        self,
        increment: ImuIncrement | None,
        features: StereoFeatures,
        start: NavState,
        *,
        rig: StereoRig,
        imu: ImuConfig,
        threshold_px: float,
        imu_fault: ImuFaultDetector,
    ) -> Step:
        """Return a frame with its motion, which is the one seen if the IMU's is unknown or faulty.

        Args:
            increment: motion since the frame before.
            features: of the frame.
            start: the estimate at the frame before.
            rig: calibration.
            imu: gravity.
            threshold_px: largest reprojection error of a track.
            imu_fault: whether the readings can be used.

        Returns:
            Tracks that contradict the motion seen have ended; if it remains unknown, there are no points at all.
        """
        before, self._before = self._before, features.without_descriptors
        if increment is None or before is None:
            return Step(increment, features)
        unknown = _unknown_share(increment)
        if unknown <= SEEN_BEYOND and not imu_fault.is_suspected:
            return Step(increment, features)
        found = _motion_seen(before, features, rig, threshold_px)
        apart_rad = float(np.linalg.norm(so3_log(increment.delta_R.T @ found[0].R))) if found else None
        if imu_fault.reason:
            increment, unknown = unknown_motion_since(start, increment.stamp_ns, imu), 1.0
        if unknown <= SEEN_BEYOND:
            return Step(increment, features, apart_rad=apart_rad)
        if found is not None:
            T_start_end, contradicting, count = found
            tracks = features.tracks.copy()
            tracks[contradicting] = 0
            moved = _moved(increment, start, T_start_end, imu)
            return Step(moved, dataclasses.replace(features, tracks=tracks), count, apart_rad)
        return Step(increment, features if unknown <= COAST_BEYOND else StereoFeatures.empty(features.stamp_ns))


def _unknown_share(increment: ImuIncrement) -> float:
    """Return the standard deviation of the rotation as a share of that of an unknown one."""
    unknown_rad = min(UNKNOWN_RATE_SIGMA * increment.dt_s, MOST_ROTATION_SIGMA)
    return float(np.sqrt(np.diagonal(increment.covariance)[:3].max())) / unknown_rad


def _motion_seen(
    before: StereoFeatures, features: StereoFeatures, rig: StereoRig, threshold_px: float
) -> tuple[Pose, Rows, int] | None:
    """Return T_before_now of the body, the rows of tracks that contradict it, and the number of those that agree.

    None if too few agree.
    """
    tracked = np.flatnonzero(features.tracks)
    _, old, new = np.intersect1d(before.tracks, features.tracks[tracked], return_indices=True)
    points = rig.triangulate(before.pixels[old].astype(float))
    usable = np.isfinite(points).all(axis=1)
    points, rows = points[usable], tracked[new[usable]]
    pixels = features.pixels[rows, :2].astype(float)
    solved = pnp_ransac(points, pixels, rig.left, Pose.identity(), threshold_px=threshold_px)
    if solved is None or solved[1].sum() < MIN_INLIERS:
        return None
    T_before_now, agree = solved
    return rig.T_body_left @ T_before_now @ rig.T_body_left.inverse(), rows[~agree], int(agree.sum())


def _moved(unknown: ImuIncrement, start: NavState, T_start_end: Pose, imu: ImuConfig) -> ImuIncrement:
    """Return an increment that moves the estimate by `T_start_end`.

    A short motion ends with its mean velocity, a long one with that of its start: a clock that was set looks the same.
    """
    dt, R = unknown.dt_s, start.T_map_body.R
    v_start = R.T @ start.v_map
    v_end = T_start_end.t / dt if dt <= LEAP_S else v_start
    fall = R.T @ np.array([0.0, 0.0, -imu.gravity]) * dt
    sigma_v = np.hypot(UNKNOWN_SPEED_SIGMA, np.sqrt(unknown.covariance[3, 3]))
    sigma = np.repeat([FLAT_ROTATION_SIGMA, sigma_v, FLAT_POSITION_SIGMA], 3)
    return dataclasses.replace(
        unknown,
        delta_R=T_start_end.R,
        delta_v=v_end - v_start - fall,
        delta_p=T_start_end.t - v_start * dt - 0.5 * fall * dt,
        rate_end=start.gyro_bias + so3_log(T_start_end.R) / dt,
        rate_slope_end=np.zeros(3),
        gyro_bias=start.gyro_bias,
        accel_bias=start.accel_bias,
        bias_jacobian=np.zeros((9, 6)),
        covariance=np.diag(sigma**2),
    )
