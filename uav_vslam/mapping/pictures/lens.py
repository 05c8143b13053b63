# SPDX-License-Identifier: Apache-2.0
"""A lens with one focal length, a principal point and radial distortion around it, and its derivatives.

A point (x, y, 1) at r^2 = x^2 + y^2 is imaged at f ((1 + k1 r^2 + k2 r^4) (x, y) + (px, py)) from the image's centre.
The parameters are (log f, k1, k2, px, py): the logarithm keeps f positive, and gives its uncertainty as a share.
"""

import numpy as np
from numpy.typing import NDArray

from uav_vslam.geometry.camera import PinholeCamera

Array = NDArray[np.float64]

PARAMETERS = 5
TYPICAL_FOCAL = 0.85  # of the image's longest side, for a camera of which nothing is known: 61 degrees across
LEAST_DEPTH = 1e-6
UNDISTORT_ITERATIONS = 10


def project(points_cam: Array, lens: Array) -> Array:
    """Return (M, 2) pixels from the image's centre of (M, 3) points in the camera, through (M, 5) lens parameters."""
    xy = points_cam[:, :2] / _depth(points_cam)[:, None]
    r2 = (xy**2).sum(axis=1)
    radial = 1.0 + r2 * (lens[:, 1] + r2 * lens[:, 2])
    return np.asarray(np.exp(lens[:, :1]) * (radial[:, None] * xy + lens[:, 3:]))


def project_jacobians(points_cam: Array, lens: Array) -> tuple[Array, Array]:
    """Return d(pixels)/d(point): (M, 2, 3), and d(pixels)/d(lens): (M, 2, 5)."""
    depth = _depth(points_cam)
    xy = points_cam[:, :2] / depth[:, None]
    r2 = (xy**2).sum(axis=1)
    f, k1, k2 = np.exp(lens[:, 0]), lens[:, 1], lens[:, 2]
    radial, slope = 1.0 + r2 * (k1 + r2 * k2), 2.0 * (k1 + 2.0 * k2 * r2)
    by_xy = f[:, None, None] * (radial[:, None, None] * np.eye(2) + slope[:, None, None] * xy[:, :, None] * xy[:, None])
    xy_by_point = np.zeros((len(xy), 2, 3))
    xy_by_point[:, 0, 0] = xy_by_point[:, 1, 1] = 1.0 / depth
    xy_by_point[:, :, 2] = -xy / depth[:, None]
    by_lens = np.zeros((len(xy), 2, PARAMETERS))
    by_lens[:, :, 0] = radial[:, None] * xy + lens[:, 3:]
    by_lens[:, :, 1], by_lens[:, :, 2] = r2[:, None] * xy, (r2**2)[:, None] * xy
    by_lens[:, :, 3:] = np.eye(2)
    return by_xy @ xy_by_point, f[:, None, None] * by_lens


def _depth(points_cam: Array) -> Array:
    """Return depths, which must not be zero; a point behind the camera keeps its negative depth."""
    z = points_cam[:, 2]
    return np.where(np.abs(z) < LEAST_DEPTH, LEAST_DEPTH, z)


def camera_of(lens: Array, width: int, height: int) -> PinholeCamera:
    """Return the camera of (5,) parameters; pixel centres are whole numbers."""
    f = float(np.exp(lens[0]))
    distortion = np.array([lens[1], lens[2], 0.0, 0.0, 0.0])
    cx, cy = 0.5 * (width - 1) + f * float(lens[3]), 0.5 * (height - 1) + f * float(lens[4])
    return PinholeCamera(width, height, f, f, cx, cy, distortion)


def bearings(pixels: Array, lens: Array) -> Array:
    """Return (M, 2) x, y of rays (x, y, 1) through (M, 2) pixels from the image's centre, by fixed-point iteration."""
    raw = pixels / np.exp(lens[:, :1]) - lens[:, 3:]
    xy = raw.copy()
    for _ in range(UNDISTORT_ITERATIONS):
        r2 = (xy**2).sum(axis=1, keepdims=True)
        xy = raw / (1.0 + r2 * (lens[:, 1:2] + r2 * lens[:, 2:3]))
    return np.asarray(xy)


def fold_radius(k1: float, k2: float) -> float:
    """Return the radius r beyond which r (1 + k1 r^2 + k2 r^4) falls: points there would be imaged where others are."""
    squares = np.roots([5.0 * k2, 3.0 * k1, 1.0])  # of r, where the derivative is zero
    real = squares.real[(np.abs(squares.imag) < 1e-12) & (squares.real > 0.0)]
    return float(np.sqrt(real.min())) if len(real) else float("inf")
