# SPDX-License-Identifier: Apache-2.0
"""Connected dominating sets of keypoints, sections 6.2.3 and 6.2.4 of [thesis]: fewer points, spread over the image.

In the graph of each keypoint with its K nearest, the set contains a neighbour of every point and is connected. It is
found by the greedy algorithm I of [guha98]: a tree grows from the point with most neighbours, always at the leaf that
adds most new points; its inner nodes are the set.

Only the first image is reduced: two independent sets hardly share points, and the ratio test in the second image needs
all candidates.
"""

import numpy as np
import scipy
from numpy.typing import NDArray

from uav_vslam.vision.features.base import Keypoints
from uav_vslam.vision.matching.gtm import gtm
from uav_vslam.vision.matching.nn_ratio import nn_mutual

Rows = NDArray[np.intp]

NEIGHBOURS = 8  # K


def cds_nn(a: Keypoints, b: Keypoints, ratio: float) -> NDArray[np.intp]:
    """Match the connected dominating set of `a` by mutual nearest descriptors."""
    rows = dominating_points(a.pixels)
    pairs = nn_mutual(a.chosen(rows), b, ratio)
    return np.column_stack([rows[pairs[:, 0]], pairs[:, 1]])


def cds_gtm(a: Keypoints, b: Keypoints, ratio: float) -> NDArray[np.intp]:
    """Match the connected dominating set of `a` by mutual nearest descriptors and graph transformation."""
    rows = dominating_points(a.pixels)
    pairs = gtm(a.chosen(rows), b, ratio)
    return np.column_stack([rows[pairs[:, 0]], pairs[:, 1]])


def dominating_points(pixels: NDArray[np.floating]) -> Rows:
    """Return the ascending rows of a connected dominating set of the neighbourhood graph of (N, 2) pixels."""
    return connected_dominating_set(neighbourhood_graph(pixels, NEIGHBOURS))


def neighbourhood_graph(points: NDArray[np.floating], neighbours: int) -> "scipy.sparse.csr_array":
    """Return the symmetric (N, N) adjacency of each of (N, D) points with its nearest ones."""
    count = len(points)
    ranks = np.arange(1, min(count, neighbours + 1) + 1)
    near = scipy.spatial.cKDTree(points).query(points, ranks)[1] if count else np.zeros((0, 0), np.intp)
    start, end = np.repeat(np.arange(count), len(ranks)), near.ravel()
    apart = start != end
    start, end = start[apart], end[apart]
    edges = scipy.sparse.csr_array((np.ones(len(start), bool), (start, end)), shape=(count, count))
    return scipy.sparse.csr_array(edges + edges.T)


def connected_dominating_set(graph: "scipy.sparse.csr_array") -> Rows:
    """Return the ascending rows of a set that is connected in each component of the graph and dominates all vertices.

    Args:
        graph: (N, N) symmetric adjacency without loops.
    """
    starts, ends = graph.indptr, graph.indices
    degree = np.diff(starts)
    found, reached = np.zeros(len(degree), bool), np.zeros(len(degree), bool)
    gain = degree.astype(np.intp)  # neighbours not reached yet

    def reach(rows: Rows) -> None:
        reached[rows] = True
        for row in rows:
            gain[ends[starts[row] : starts[row + 1]]] -= 1

    while True:
        leaves = np.flatnonzero(reached & (gain > 0))
        if len(leaves):
            grown = leaves[np.argmax(gain[leaves])]
        elif not reached.all():  # this component is complete; start the next
            grown = np.argmax(np.where(reached, -1, degree))
            reach(np.array([grown]))
        else:
            return np.flatnonzero(found)
        found[grown] = True
        near = ends[starts[grown] : starts[grown + 1]]
        reach(near[~reached[near]])
