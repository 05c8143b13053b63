# SPDX-License-Identifier: Apache-2.0
"""The points of a flight: where they are at first, how noisy their observations are, and which ones don't fit."""

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaincinv

from uav_vslam.smoothing.cameras import Cameras, PixelNoise
from uav_vslam.smoothing.sightings import Rows, Sightings
from uav_vslam.smoothing.views import HUBER, POINT_DIM, Ties, linearise

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
    """Tie P points to their landmarks (L, 3), `rows` of each or -1, robustly; see `apart` for sigma."""
    distance = apart(rows, points, landmarks)
    sigmas = np.linalg.norm(distance, axis=1) / sigma_m
    weight = np.minimum(1.0, HUBER / np.maximum(sigmas, 1e-6))
    information = np.where(rows >= 0, weight * sigma_m**-2.0, 0.0)
    return Ties(rows, information, information[:, None] * distance)


def wrongly_tied(rows: Rows, points: Array, landmarks: Array, sigma_m: Array, *, probability: float) -> Rows:
    """Return the landmarks of which a point is farther away than the chi-square gate allows."""
    sigmas2 = np.sum(apart(rows, points, landmarks) ** 2, axis=1) / sigma_m**2
    return np.unique(rows[sigmas2 > 2.0 * gammaincinv(1.5, probability)])


def apart(rows: Rows, points: Array, landmarks: Array) -> Array:
    """Return (P, 3) landmark minus point [m], each axis of which has a standard deviation sigma (P,); zero for none."""
    tied = rows >= 0
    distance = np.zeros((len(rows), 3))
    distance[tied] = landmarks[rows[tied]] - points[tied, :3]
    return distance


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
