# SPDX-License-Identifier: Apache-2.0
"""Nearest neighbour with ratio test (Lowe 2004) and mutual check, section 3.4 of [thesis].

Distances of 8-bit descriptors are integers below 2^24, so they are exact in float32 for any summation order of BLAS:
the result is the same on every machine.
"""

import numpy as np
from numpy.typing import NDArray

from uav_vslam.vision.features.base import Keypoints

SINGLE_CANDIDATE_DISTANCE = 250.0  # between SIFT descriptors, whose length is about 512
# The same by descriptor length: SIFT and variants, SURF, ORB, PHOW. It is 0.7 of the first percentile of distances
# between wrong pairs on rendered images; for unknown lengths a single candidate is never accepted.
SINGLE_CANDIDATE_DISTANCES = {128: SINGLE_CANDIDATE_DISTANCE, 65: 53.0, 256: 6.3, 384: 390.0}


def nn(a: Keypoints, b: Keypoints, ratio: float) -> NDArray[np.intp]:
    """Match each keypoint of `a` to its nearest of `b` if it passes the ratio test; `b`'s may repeat."""
    return match_descriptors(a.descriptors, b.descriptors, ratio, mutual=False)


def nn_mutual(a: Keypoints, b: Keypoints, ratio: float) -> NDArray[np.intp]:
    """Match mutual nearest keypoints that pass the ratio test: none is used twice."""
    return match_descriptors(a.descriptors, b.descriptors, ratio)


def match_descriptors(
    a: NDArray[np.generic],
    b: NDArray[np.generic],
    ratio: float,
    *,
    mutual: bool = True,
    single_distance: float | None = None,
) -> NDArray[np.intp]:
    """Match each row of `a` to its nearest row of `b`.

    Args:
        a, b: (Na, D), (Nb, D) uint8 or float descriptors.
        ratio: the nearest must be closer than this times the second nearest.
        mutual: keep only mutual nearest neighbours.
        single_distance: largest distance if `b` has one row only, where there is no ratio; None: that of
            SINGLE_CANDIDATE_DISTANCES.

    Returns:
        (M, 2) indices into `a` and `b`, ascending in `a`.
    """
    return match_distances(squared_distances(a, b), ratio, mutual=mutual, single_distance=_single(a, single_distance))


def match_gated(
    a: NDArray[np.generic],
    b: NDArray[np.generic],
    allowed: NDArray[np.bool_],
    ratio: float,
    *,
    single_distance: float | None = None,
) -> NDArray[np.intp]:
    """Match as `match_descriptors` does, among allowed pairs only; the ratio test ignores excluded candidates too.

    Args:
        a, b: (Na, D), (Nb, D) uint8 or float descriptors.
        allowed: (Na, Nb) pairs that may match.
        ratio: the nearest allowed must be closer than this times the second nearest allowed.
        single_distance: largest distance if only one candidate is allowed; None: that of
            SINGLE_CANDIDATE_DISTANCES.

    Returns:
        (M, 2) indices into `a` and `b`, ascending in `a`.
    """
    if allowed.shape != (len(a), len(b)):
        raise ValueError(f"allowed is {allowed.shape}, but there are {len(a)} x {len(b)} descriptors")
    squared = np.where(allowed, squared_distances(a, b), np.float32(np.inf))
    return match_distances(squared, ratio, single_distance=_single(a, single_distance))


def squared_distances(a: NDArray[np.generic], b: NDArray[np.generic]) -> NDArray[np.float32]:
    """Return (Na, Nb) squared Euclidean distances, |a|^2 + |b|^2 - 2 a.b; exact for uint8 descriptors."""
    if len(a) == 0 or len(b) == 0:
        return np.zeros((len(a), len(b)), np.float32)
    if a.shape[1] != b.shape[1]:
        raise ValueError(f"descriptors of {a.shape[1]} and {b.shape[1]} numbers can't be compared")
    fa, fb = np.asarray(a, np.float32), np.asarray(b, np.float32)
    squared = fa @ fb.T
    squared *= -2.0
    squared += np.einsum("ij,ij->i", fa, fa)[:, None]
    squared += np.einsum("ij,ij->i", fb, fb)[None, :]
    return np.maximum(squared, 0.0, out=squared)


def match_distances(
    squared: NDArray[np.float32], ratio: float, *, mutual: bool = True, single_distance: float
) -> NDArray[np.intp]:
    """Match as `match_gated` does, by (Na, Nb) squared distances of any kind, inf where not allowed."""
    if squared.size == 0:
        return np.zeros((0, 2), np.intp)
    rows = np.arange(len(squared))
    best = np.argmin(squared, axis=1)
    first = squared[rows, best].astype(np.float64)
    second = _second_smallest(squared, best)
    good = np.where(np.isfinite(second), first < ratio**2 * second, first < single_distance**2)
    good &= np.isfinite(first)
    if mutual and good.any():
        passed = np.flatnonzero(good)  # few of all columns, which are slow to search in memory of rows
        good[passed] = np.argmin(squared[:, best[passed]], axis=0) == passed
    return np.stack([rows[good], best[good]], axis=1)


def _single(descriptors: NDArray[np.generic], single_distance: float | None) -> float:
    if single_distance is not None:
        return single_distance
    return SINGLE_CANDIDATE_DISTANCES.get(descriptors.shape[1], 0.0)


def _second_smallest(squared: NDArray[np.float32], best: NDArray[np.intp]) -> NDArray[np.float64]:
    """Return each row's smallest value except at `best`; inf if there is none."""
    rows = np.arange(len(squared))
    others = squared.copy()
    others[rows, best] = np.inf
    return others.min(axis=1).astype(np.float64)
