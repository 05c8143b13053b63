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
BLOCK = 32  # states, whose points are linearised at a time


def triangulated(sightings: Sightings, cameras: Cameras) -> Array:
    """Return (P, 7) unknowns of the points, each from its view of median depth; NaN where no view gives a depth."""
    points_left = cameras.rig.triangulate(sightings.pixels)
    known = np.isfinite(points_left[:, 2])
    order = np.lexsort((np.where(known, points_left[:, 2], np.inf), sightings.points))
    known_views = np.bincount(sightings.points, weights=known, minlength=len(sightings.landmarks)).astype(np.intp)
    median = order[sightings.starts + np.maximum(known_views - 1, 0) // 2]
    points = np.zeros((len(median), POINT_DIM))
    points[:, :3] = cameras.to_map(sightings.states[median], points_left[median])
    return points


def revisited(sightings: Sightings, points: Array) -> Array:
    """Return (L, 3) positions of the revisited landmarks, those of the first point of each."""
    linked = np.flatnonzero(sightings.landmarks >= 0)
    first = np.unique(sightings.landmarks[linked], return_index=True)[1]
    return points[linked[first], :3].copy()


def misfits(sightings: Sightings, cameras: Cameras, points: Array, noise: PixelNoise) -> Array:
    """Return (M,) squared lengths of the normalised residuals; in parts, as the Jacobians of all fill the memory."""
    parts = (linearise(part, cameras, points[own], noise) for _, own, part in sightings.by_block(BLOCK))
    return np.concatenate([np.zeros(0), *(part.misfit for part in parts)])


def residual_px(sightings: Sightings, cameras: Cameras, points: Array, noise: PixelNoise) -> float | None:
    """Return the typical residual [px], by the median over the observations; None for too few points."""
    if len(points) < LEAST_POINTS:
        return None
    misfit = misfits(sightings, cameras, points, noise)
    freedom = 4.0 - 3.0 / np.bincount(sightings.points)[sightings.points]  # a point's position is fitted, too
    return float(noise.white_px * np.sqrt(np.median(misfit / (2.0 * gammaincinv(0.5 * freedom, 0.5)))))


def fitting(
    sightings: Sightings, cameras: Cameras, points: Array, noise: PixelNoise, *, probability: float
) -> NDArray[np.bool_]:
    """Return which of (P, 7) points have enough views that are not wrong, and pass the chi-square gate on those.

    Two views are enough, and one of a revisited landmark: it ties its state to the landmark's other views.
    """
    misfit = misfits(sightings, cameras, points, noise)
    right, count = misfit <= noise.cut**2, len(points)
    views = np.bincount(sightings.points, weights=right, minlength=count)
    of_views = np.bincount(sightings.points, weights=misfit * right, minlength=count)
    total = of_views + points[:, 3:] ** 2 @ noise.prior_information
    freedom = np.maximum(4.0 * views - 3.0, 1.0)
    enough = views >= np.where(sightings.landmarks >= 0, 1, 2)
    return np.asarray(enough & (total <= 2.0 * gammaincinv(0.5 * freedom, probability)))


def ties(rows: Rows, points: Array, landmarks: Array, sigma_m: Array) -> Ties:
    """Tie P points to their landmarks (L, 3), `rows` of each or -1, robustly; see `apart` for sigma."""
    distance = apart(rows, points, landmarks)
    sigmas = np.linalg.norm(distance, axis=1) / sigma_m
    weight = np.minimum(1.0, HUBER / np.maximum(sigmas, 1e-6))
    information = np.where(rows >= 0, weight * sigma_m**-2.0, 0.0)
    return Ties(rows, information, information[:, None] * distance)


def wrongly_tied(rows: Rows, points: Array, landmarks: Array, sigma_m: Array, *, probability: float) -> Rows:
    """Return the ascending rows of landmarks of which a point is farther away than the chi-square gate allows.

    Args:
        rows: (P,) landmark of each point, -1 for none.
        points, landmarks: (P, 7) and (L, 3) [m].
        sigma_m: (P,) as for `apart`.
        probability: that a point of the landmark passes.
    """
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
