# SPDX-License-Identifier: Apache-2.0
"""Hypergraph transformation matching, section 6.4.2 of [thesis].

The vertices are coarse matches of a feature with a landmark, with the geometry of both. A hyperedge joins a match with
two of its K nearest in the image; among right matches the three have the same shape in the image and in the map as the
camera should see it, whatever rotation, shift and scale the prediction is off by. While shapes differ, the match goes
that the largest share of its hyperedges speaks against; the hypergraph of those left is built anew until all agree.

Unlike [aguilar09], which asks only who is whose neighbour, that notices a match that is wrong by a little.
"""

from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

Array = NDArray[np.float64]
Rows = NDArray[np.intp]

NEIGHBOURS = 6  # K
TOLERANCE_PX = 1.5  # that three points may be off a similarity
TOLERANCE_SHARE = 0.01  # of their extent, beside it: the ground is not flat, and landmarks are not where we think
SCALES = (0.5, 2.0)  # of the image to what is expected; beyond it the prediction can't be off


def same_shapes(expected: Array, observed: Array, *, neighbours: int = NEIGHBOURS) -> Rows:
    """Return the matches whose hyperedges all have one shape on both sides; one without any is not among them.

    Args:
        expected: (N, 2) where the landmarks should be in the image [px].
        observed: (N, 2) where the features matched with them are [px].
        neighbours: K.

    Returns:
        (M,) ascending rows.
    """
    left = np.arange(len(observed))
    while True:
        triples = left[hyperedges(observed[left], neighbours)]
        wrong = ~_similar(expected[triples], observed[triples])
        if not wrong.any():
            return np.unique(triples)
        left = np.setdiff1d(left, _contradicted_hyperedges(triples, wrong))


def hyperedges(points: Array, neighbours: int) -> NDArray[np.intp]:
    """Return (E, 3) ascending rows of (N, 2) points: each with each two of its nearest, the same three only once."""
    count = min(neighbours, len(points) - 1)
    if count < 2:
        return np.zeros((0, 3), np.intp)
    own = np.arange(len(points))[:, None]
    near = cKDTree(points).query(points, count + 1)[1]
    near = np.take_along_axis(near, np.argsort(near == own, axis=1, kind="stable"), axis=1)[:, :count]  # not itself
    triples = [np.hstack([own, near[:, [i, j]]]) for i, j in combinations(range(count), 2)]
    return np.unique(np.sort(np.vstack(triples), axis=1), axis=0)


def _similar(expected: Array, observed: Array) -> NDArray[np.bool_]:
    """Tell which of (E, 3, 2) triangles are similar, by the least-squares similarity o = a e + b of complex numbers."""
    e, o = (side[..., 0] + 1j * side[..., 1] for side in (expected, observed))
    e, o = e - e.mean(axis=1, keepdims=True), o - o.mean(axis=1, keepdims=True)
    extent2 = np.maximum((np.abs(e) ** 2).sum(axis=1), 1e-12)
    scale = (np.conj(e) * o).sum(axis=1) / extent2
    off = np.abs(o - scale[:, None] * e).max(axis=1)
    near = off <= TOLERANCE_PX + TOLERANCE_SHARE * np.abs(o).max(axis=1)
    return np.asarray(near & (np.abs(scale) >= SCALES[0]) & (np.abs(scale) <= SCALES[1]))


def _contradicted_hyperedges(triples: NDArray[np.intp], wrong: NDArray[np.bool_]) -> list[int]:
    """Return whom to take away until no wrong hyperedge is left, whoever has the largest share of wrong ones first."""
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
