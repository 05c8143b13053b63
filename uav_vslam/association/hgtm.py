# SPDX-License-Identifier: Apache-2.0
"""Hypergraph transformation matching, section 6.4.2 of [thesis].

The vertices are coarse matches of features with landmarks. A hyperedge joins a match with two of its K nearest in the
image; for correct matches the triangle has the same shape in the image and in the predicted view of the map, up to
rotation, shift and scale of the prediction. While shapes differ, the match with the largest share of contradicting
hyperedges is removed and the hypergraph rebuilt, until all agree.

Unlike [aguilar09], which compares only neighbourhoods, this detects matches that are wrong by a few pixels.
"""

from itertools import combinations

import numpy as np
import scipy
from numpy.typing import NDArray

Array = NDArray[np.float64]
Rows = NDArray[np.intp]

NEIGHBOURS = 6  # K
TOLERANCE_PX = 1.5  # largest residual of three points after a similarity fit
TOLERANCE_SHARE = 0.01  # of their extent, in addition: the ground is not flat, and landmarks are uncertain
SCALES = (0.5, 2.0)  # plausible scales of the image relative to the prediction


def same_shapes(expected: Array, observed: Array, *, tolerance: float = TOLERANCE_PX) -> Rows:
    """Return the matches whose hyperedges all have equal shapes on both sides; matches without hyperedges are dropped.

    Args:
        expected: (N, 2) predicted pixels of the landmarks [px], or points of another plane in its own unit.
        observed: (N, 2) pixels of the matched features, in the same unit.
        tolerance: largest residual of three points after a similarity fit, in the same unit.

    Returns:
        (M,) ascending rows.
    """
    left = np.arange(len(observed))
    while True:
        triples = left[hyperedges(observed[left], NEIGHBOURS)]
        wrong = ~_similar(expected[triples], observed[triples], tolerance)
        if not wrong.any():
            return np.unique(triples)
        left = np.setdiff1d(left, _contradicted_hyperedges(triples, wrong))


def hyperedges(points: Array, neighbours: int) -> NDArray[np.intp]:
    """Return (E, 3) ascending rows of (N, 2) points: each with every two of its nearest, without duplicates."""
    count = min(neighbours, len(points) - 1)
    if count < 2:
        return np.zeros((0, 3), np.intp)
    own = np.arange(len(points))[:, None]
    near = scipy.spatial.cKDTree(points).query(points, count + 1)[1]
    near = np.take_along_axis(near, np.argsort(near == own, axis=1, kind="stable"), axis=1)[:, :count]  # without itself
    triples = [np.hstack([own, near[:, [i, j]]]) for i, j in combinations(range(count), 2)]
    return np.unique(np.sort(np.vstack(triples), axis=1), axis=0)


def _similar(expected: Array, observed: Array, tolerance: float) -> NDArray[np.bool_]:
    """Return which of (E, 3, 2) triangles are similar, by the least-squares fit o = a e + b of complex numbers."""
    e, o = (side[..., 0] + 1j * side[..., 1] for side in (expected, observed))
    e, o = e - e.mean(axis=1, keepdims=True), o - o.mean(axis=1, keepdims=True)
    extent2 = np.maximum((np.abs(e) ** 2).sum(axis=1), 1e-12)
    scale = (np.conj(e) * o).sum(axis=1) / extent2
    off = np.abs(o - scale[:, None] * e).max(axis=1)
    near = off <= tolerance + TOLERANCE_SHARE * np.abs(o).max(axis=1)
    return np.asarray(near & (np.abs(scale) >= SCALES[0]) & (np.abs(scale) <= SCALES[1]))


def _contradicted_hyperedges(triples: NDArray[np.intp], wrong: NDArray[np.bool_]) -> list[int]:
    """Return the vertices to remove until no wrong hyperedge is left, largest share of wrong ones first."""
    gone = []
    while wrong.any():
        own = np.bincount(triples.ravel())
        against = np.bincount(triples[wrong].ravel(), minlength=len(own))
        share = against / np.maximum(own, 1)
        worst = int(np.lexsort((against, share))[-1])
        gone.append(worst)
        others = (triples != worst).all(axis=1)
        triples, wrong = triples[others], wrong[others]
    return gone
