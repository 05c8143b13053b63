# SPDX-License-Identifier: Apache-2.0
"""Which pictures are matched, and the matches of a pair that a common geometry explains.

Aerial pictures of the ground are nearly related by a homography, and exactly by epipolar geometry. A match is accepted
if the homography explains it within `LOOSE`, which leaves room for relief, or the fundamental matrix within `TIGHT` and
the homography not too badly: what stands high.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from uav_vslam.geometry.plane import similarity_between
from uav_vslam.mapping.pictures.features import PictureFeatures
from uav_vslam.mapping.pictures.retrieval import similarity
from uav_vslam.vision.matching import match_descriptors

Array = NDArray[np.float64]
Pairs = NDArray[np.intp]

EXHAUSTIVE = 12  # pictures up to which every pair is tried
NEIGHBOURS_IN_TIME = 4
NEIGHBOURS_BY_GPS = 6
NEIGHBOURS_BY_LOOKS = 8
RATIO = 0.8
LOOSE, TIGHT, FAR = 8e-3, 1.5e-3, 8e-2  # errors as shares of the picture's longest side
FEWEST_INLIERS = 18
LEAST_SHARE = 0.2  # of the matches that must agree: chance leaves far fewer
FOR_FUNDAMENTAL = 30
RANSAC_STEPS = 2000
CONFIDENCE = 0.9999


@dataclass(frozen=True, slots=True)
class MatchedPair:
    """Two pictures that share ground.

    Attributes:
        first, second: their numbers, first < second.
        rows: (M, 2) matched points.
        similarity: (2, 2) scaled rotation from the first's pixels to the second's.
    """

    first: int
    second: int
    rows: Pairs
    similarity: Array


def candidates(features: Sequence[PictureFeatures], positions: Array) -> list[tuple[int, int]]:
    """Return the pairs to match, each (i, j) with i < j, in order.

    Args:
        features: of all pictures, in the order of time.
        positions: (N, 2) east and north by GPS [m]; NaN rows are unknown.
    """
    count = len(features)
    if count <= EXHAUSTIVE:
        return [(i, j) for i in range(count) for j in range(i + 1, count)]
    chosen = {(i, j) for i in range(count) for j in range(i + 1, min(count, i + 1 + NEIGHBOURS_IN_TIME))}
    alike = similarity([each.descriptors for each in features])
    chosen |= _nearest(-alike, NEIGHBOURS_BY_LOOKS)
    distance = np.linalg.norm(positions[:, None] - positions[None], axis=-1)
    chosen |= _nearest(np.where(np.isfinite(distance), distance, np.inf), NEIGHBOURS_BY_GPS)
    return sorted(chosen)


def _nearest(cost: Array, count: int) -> set[tuple[int, int]]:
    """Return each row's `count` cheapest other columns with finite cost, as ordered pairs."""
    cost = cost.copy()
    np.fill_diagonal(cost, np.inf)
    order = np.argsort(cost, axis=1, kind="stable")[:, :count]
    return {(min(i, j), max(i, j)) for i, row in enumerate(order.tolist()) for j in row if np.isfinite(cost[i, j])}


def match_all(
    features: Sequence[PictureFeatures],
    sides_px: Sequence[int],
    pairs: Sequence[tuple[int, int]],
    *,
    on_pair: Callable[[], object] = lambda: None,
) -> list[MatchedPair]:
    """Match candidate pairs and return those with a common geometry.

    Args:
        features: of all pictures.
        sides_px: longest side of each picture.
        pairs: numbers of the pictures to match.
        on_pair: called after each pair.
    """
    found = []
    for i, j in pairs:
        matched = match_pair(features[i], features[j], (sides_px[i], sides_px[j]))
        if matched is not None:
            found.append(MatchedPair(i, j, *matched))
        on_pair()
    return found


def match_pair(a: PictureFeatures, b: PictureFeatures, sides_px: tuple[int, int]) -> tuple[Pairs, Array] | None:
    """Return the matches of two pictures and the similarity between their pixels; None if no geometry explains them."""
    rows = match_descriptors(a.descriptors, b.descriptors, RATIO)
    if len(rows) < FEWEST_INLIERS:
        return None
    p, q = a.pixels[rows[:, 0]], b.pixels[rows[:, 1]]
    good = agreeing(p, q, sides_px[1])
    if good.sum() < max(FEWEST_INLIERS, LEAST_SHARE * len(rows)):
        return None
    scaled_rotation = similarity_between(p[good], q[good])
    return None if scaled_rotation is None else (rows[good], scaled_rotation)


def agreeing(p: Array, q: Array, side_px: float) -> NDArray[np.bool_]:
    """Return which matches (N, 2) to (N, 2) one geometry explains; all False if none was found.

    Args:
        p, q: matched pixels.
        side_px: longest side of the picture of `q`.
    """
    cv2.setRNGSeed(len(p))
    H, _ = cv2.findHomography(p, q, cv2.RANSAC, LOOSE * side_px, maxIters=RANSAC_STEPS, confidence=CONFIDENCE)
    if H is None or np.linalg.det(H[:2, :2]) <= 0.0:  # a mirror image
        return np.zeros(len(p), bool)
    mapped = np.column_stack([p, np.ones(len(p))]) @ H.T
    error = np.linalg.norm(mapped[:, :2] / mapped[:, 2:] - q, axis=1)
    error[mapped[:, 2] <= 0.0] = np.inf
    good = error <= LOOSE * side_px
    standing = (error > LOOSE * side_px) & (error <= FAR * side_px)
    if good.sum() >= FEWEST_INLIERS and standing.sum() >= FOR_FUNDAMENTAL:
        good |= standing & _epipolar(p, q, TIGHT * side_px)
    return np.asarray(good)


def _epipolar(p: Array, q: Array, threshold_px: float) -> NDArray[np.bool_]:
    F, inlier = cv2.findFundamentalMat(p, q, cv2.USAC_ACCURATE, threshold_px, CONFIDENCE, RANSAC_STEPS)
    return np.zeros(len(p), bool) if F is None else np.asarray(inlier.ravel() > 0)
