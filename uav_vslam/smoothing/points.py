# SPDX-License-Identifier: Apache-2.0
"""The points of a flight: where they are at first, how noisy their observations are, and which ones don't fit."""

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaincinv

from uav_vslam.smoothing.cameras import Cameras, PixelNoise
from uav_vslam.smoothing.sightings import Rows, Sightings
from uav_vslam.smoothing.views import POINT_DIM, Ties, linearise

Array = NDArray[np.float64]

LEAST_POINTS = 30  # to measure the noise


def triangulated(sightings: Sightings, cameras: Cameras) -> Array:
    """Return (P, 7) unknowns of the points, each from its nearest view; NaN where no view gives a depth."""
    points_left = cameras.rig.triangulate(sightings.pixels)
    depth = np.where(np.isfinite(points_left[:, 2]), points_left[:, 2], np.inf)
    nearest = np.lexsort((depth, sightings.points))[sightings.starts]
    points = np.zeros((len(nearest), POINT_DIM))
    points[:, :3] = cameras.to_map(sightings.states[nearest], points_left[nearest])
    return points


def revisited(sightings: Sightings, points: Array) -> Array:
    """Return (L, 3) positions of the revisited landmarks, those of the first point of each."""
    linked = np.flatnonzero(sightings.landmarks >= 0)
    first = np.unique(sightings.landmarks[linked], return_index=True)[1]
    return points[linked[first], :3].copy()


def residual_px(sightings: Sightings, cameras: Cameras, points: Array, noise: PixelNoise) -> float | None:
    """Return the typical residual [px], by the median over the points; None for too few points."""
    total, freedom = _chi2(sightings, cameras, points, noise)
    if len(total) < LEAST_POINTS:
        return None
    return float(noise.white_px * np.sqrt(np.median(total / (2.0 * gammaincinv(0.5 * freedom, 0.5)))))


def fitting(
    sightings: Sightings, cameras: Cameras, points: Array, noise: PixelNoise, *, probability: float
) -> NDArray[np.bool_]:
    """Return which points pass the chi-square gate on their residuals."""
    total, freedom = _chi2(sightings, cameras, points, noise)
    return np.asarray(total <= 2.0 * gammaincinv(0.5 * freedom, probability))


def ties(rows: Rows, points: Array, landmarks: Array, sigma_m: Array) -> Ties:
    """Tie P points to their landmarks (L, 3), `rows` of each or -1, by a distance of sigma (P,) on each axis [m]."""
    tied = rows >= 0
    information = tied / sigma_m**2
    pull = np.zeros((len(rows), 3))
    pull[tied] = information[tied, None] * (landmarks[rows[tied]] - points[tied, :3])
    return Ties(rows, information, pull)


def tie_sigma_m(sightings: Sightings, cameras: Cameras, points: Array, redetection_px: float) -> Array:
    """Return (P,) distances of points from their landmark on each axis [m]: two detections are redetection_px apart."""
    depth = cameras.points_left(sightings.states[sightings.starts], points[:, :3])[:, 2]
    return np.asarray(np.abs(depth) * redetection_px / (np.sqrt(2.0) * cameras.rig.left.fx))


def _chi2(sightings: Sightings, cameras: Cameras, points: Array, noise: PixelNoise) -> tuple[Array, Array]:
    """Return (P,) normalised squares of residuals, offset and drift of each point, and their degrees of freedom."""
    misfit = linearise(sightings, cameras, points, noise).misfit
    own = points[:, 3:] ** 2 @ noise.prior_information
    count = len(points)
    total = np.bincount(sightings.points, weights=misfit, minlength=count) + own
    return total, np.asarray(4.0 * np.bincount(sightings.points, minlength=count) - 3.0, dtype=np.float64)
