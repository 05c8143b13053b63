# SPDX-License-Identifier: Apache-2.0
"""Graph transformation matching [aguilar09], section 6.3.4 of [thesis].

Correct matches have the same neighbours in both images under any smooth deformation. The matched points of each image
form a graph, with an edge from each point to its K nearest within the median distance of two points. While the graphs
differ, the match with most differing edges is removed, and edges to it move to the next nearest point. The median
remains that of all matches: with many points, the K nearest are far closer.
"""

import numpy as np
import scipy
from numpy.typing import NDArray

from uav_vslam.vision.features.base import Keypoints
from uav_vslam.vision.matching.nn_ratio import nn_mutual

Array = NDArray[np.float64]
Rows = NDArray[np.intp]
Mask = NDArray[np.bool_]

NEIGHBOURS = 5  # K
LOOKAHEAD = 40  # nearest points queried in advance; a point that has lost too many queries again


def gtm(a: Keypoints, b: Keypoints, ratio: float) -> NDArray[np.intp]:
    """Match mutual nearest descriptors, and keep those with the same neighbours in both images."""
    pairs = nn_mutual(a, b, ratio)
    return pairs[same_neighbours(a.pixels[pairs[:, 0]], b.pixels[pairs[:, 1]])]


def same_neighbours(a: NDArray[np.floating], b: NDArray[np.floating]) -> Rows:
    """Return the matches left when both graphs are equal; matches without neighbours are dropped.

    Args:
        a, b: (N, D), (N, E) matched points: row k of `a` matches row k of `b`.

    Returns:
        (M,) ascending rows.
    """
    if len(a) < 2:
        return np.zeros(0, np.intp)
    left = np.ones(len(a), bool)
    graphs = tuple(_Neighbourhoods(np.asarray(points, float), left) for points in (a, b))
    differing: list[set[int]] = [set() for _ in left]  # ends of the edges from each match that only one graph has
    votes = np.zeros(len(a), np.intp)  # number of these edges to each match

    def update(row: int) -> None:
        votes[list(differing[row])] -= 1
        first, second = (graph.connect(row) for graph in graphs)
        differing[row] = first ^ second
        votes[list(differing[row])] += 1

    for row in range(len(a)):
        update(row)
    while votes.any():
        worst = int(np.argmax(votes))
        left[worst] = False
        for row in sorted({worst, *graphs[0].starts[worst], *graphs[1].starts[worst]}):
            update(row)
    return np.array([row for row in np.flatnonzero(left) if graphs[0].ends[row]], np.intp)


class _Neighbourhoods:
    """One graph: edges from each remaining point to its nearest remaining ones.

    Attributes:
        ends: targets of each point's edges.
        starts: sources of the edges to each point.
    """

    def __init__(self, points: Array, left: Mask) -> None:
        self.ends: list[set[int]] = [set() for _ in points]
        self.starts: list[set[int]] = [set() for _ in points]
        self._points, self._left = points, left
        apart = scipy.spatial.distance.pdist(points)
        self._reach = np.nextafter(np.median(apart), np.inf)  # the tree's bound is exclusive
        self._lookahead = LOOKAHEAD
        self._near: list[Rows] = [np.zeros(0, np.intp)] * len(points)
        self._query()

    def connect(self, row: int) -> set[int]:
        """Reconnect a point to its nearest remaining points and return these; a removed point has none."""
        for end in self.ends[row]:
            self.starts[end].discard(row)
        self.ends[row] = set(self._nearest(row).tolist()) if self._left[row] else set()
        for end in self.ends[row]:
            self.starts[end].add(row)
        return self.ends[row]

    def _nearest(self, row: int) -> Rows:
        near = self._near[row]
        found = near[self._left[near]]
        if len(found) < NEIGHBOURS and len(near) == self._lookahead:  # the queried points are exhausted
            self._query()
            found = self._near[row]
        return found[:NEIGHBOURS]

    def _query(self) -> None:
        """Query the nearest points of every remaining point within reach, nearest first."""
        rows = np.flatnonzero(self._left)
        points = self._points[rows]
        ranks = np.arange(1, min(len(rows), self._lookahead + 1) + 1)
        found = scipy.spatial.cKDTree(points).query(points, ranks, distance_upper_bound=self._reach)[1]
        for row, near in zip(rows, found, strict=True):
            near = rows[near[near < len(rows)]]
            self._near[row] = near[near != row][: self._lookahead]
