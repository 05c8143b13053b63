# SPDX-License-Identifier: Apache-2.0
"""Stereo observation of landmarks: prediction, Jacobians in map-frame errors, and their smoothed depth.

`c` is a landmark in the left camera frame, `z = h(c)` its stereo pixels (Eq. 4.6.13 of [thesis]), `H` the Jacobian of z
with respect to (position, velocity, xi, biases) and to the landmark.

A new landmark's depth is noisy, and a Jacobian evaluated there correlates with the measurement noise. Over ground the
depth is known better: the Jacobian (never the residual) is evaluated at `c` scaled to a depth between the landmark's
own and the ground's (`ground_depth`), weighted by the landmark's depth variance against the relief of the ground.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from uav_vslam.estimation.ground_depth import ground_depth
from uav_vslam.geometry.rotation import skew
from uav_vslam.geometry.stereo import StereoRig
from uav_vslam.ins.propagation import NAV_DIM, POSITION, ROTATION
from uav_vslam.types import NavState

Array = NDArray[np.float64]

MIN_DEPTH_M = 0.05  # points closer than this, or behind, are not projected


@dataclass(frozen=True, slots=True)
class PointJacobian:
    """Landmarks in the left camera frame and their derivatives.

    Attributes:
        points_left: (N, 3) [m].
        nav: (N, 3, 15) d(point)/d(map-frame navigation error).
        landmark: (3, 3) d(point)/d(landmark), the same for all.
    """

    points_left: Array
    nav: Array
    landmark: Array


def in_left_camera(rig: StereoRig, nav: NavState, landmarks: Array) -> Array:
    """Transform (N, 3) map-frame landmarks [m] into the left camera frame."""
    arm_body = (landmarks - nav.T_map_body.t) @ nav.T_map_body.R
    return np.asarray((arm_body - rig.T_body_left.t) @ rig.T_body_left.R)


def point_jacobian(rig: StereoRig, nav: NavState, landmarks: Array) -> PointJacobian:
    """Transform (N, 3) map-frame landmarks [m] into the left camera frame, with derivatives."""
    R_left_map = rig.T_body_left.R.T @ nav.T_map_body.R.T
    J = np.zeros((len(landmarks), 3, NAV_DIM))
    J[:, :, POSITION] = -R_left_map
    J[:, :, ROTATION] = R_left_map @ skew(landmarks - nav.T_map_body.t)
    return PointJacobian(in_left_camera(rig, nav, landmarks), J, R_left_map)


def smoothed(
    points_left: Array,
    depth_variance: Array,
    *,
    depth_sigma_ratio: float,
    known: Callable[[], tuple[Array, Array]] | None = None,
) -> Array:
    """Scale points to depth s z + (1-s) z_ground, s = sigma^2 / (sigma^2 + var z).

    Args:
        points_left: (N, 3) [m].
        depth_variance: (N,) variance of each depth [m^2].
        depth_sigma_ratio: relief of the ground over its depth; 0 disables the smoothing.
        known: returns landmarks in view (K, 3) and their variances (K,), which may show the ground where the points do
            not: new ones, which no landmark explains, are often wrong matches, and scatter as in a room.

    Returns:
        (N, 3) linearisation points, scaled to the depth of the ground that the points in front show, if any.
    """
    depth = points_left[:, 2]
    ahead = depth > MIN_DEPTH_M
    if depth_sigma_ratio == 0 or not ahead.any():
        return points_left
    variance = np.maximum(depth_variance[ahead], 0.0)
    ground = ground_depth(points_left[ahead], variance, depth_sigma_ratio)
    if ground is None and known is not None:
        landmarks, of_landmarks = known()
        shown, of_shown = np.vstack([points_left[ahead], landmarks]), np.concatenate([variance, of_landmarks])
        of_all = ground_depth(shown, of_shown, depth_sigma_ratio)
        ground = None if of_all is None else of_all[: len(variance)]
    if ground is None:
        return points_left
    sigma2 = (depth_sigma_ratio * ground) ** 2
    s = sigma2 / (sigma2 + variance)
    scale = np.ones(len(depth))
    scale[ahead] = s + (1 - s) * ground / depth[ahead]
    return np.asarray(points_left * scale[:, None])


def projectable(rig: StereoRig, points_left: Array, *, margin_px: float = 0.0) -> NDArray[np.bool_]:
    """Return the mask of (N, 3) points in front of both cameras and inside both images, extended by a margin."""
    ahead = (points_left[:, 2] > MIN_DEPTH_M) & (rig.T_right_left.apply(points_left)[:, 2] > MIN_DEPTH_M)
    z = rig.project(np.where(ahead[:, None], points_left, [0.0, 0.0, 1.0]))
    low, high_u, high_v = -margin_px, rig.left.width - 1 + margin_px, rig.left.height - 1 + margin_px
    inside = (z[:, ::2] >= low) & (z[:, ::2] <= high_u) & (z[:, 1::2] >= low) & (z[:, 1::2] <= high_v)
    return np.asarray(ahead & inside.all(axis=1))


def triangulation_covariance(rig: StereoRig, points_left: Array, sigma_px: float) -> Array:
    """Return (N, 3, 3) covariances of points triangulated from raw pixels with sigma_px [px]."""
    J = rig.project_jacobian(points_left) / rig.magnification(rig.project(points_left))[:, None, None]
    return np.asarray(sigma_px**2 * np.linalg.inv(np.einsum("nki,nkj->nij", J, J)))
