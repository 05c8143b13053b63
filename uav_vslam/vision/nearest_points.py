# SPDX-License-Identifier: Apache-2.0
"""Nearest image points, by OpenCV's tree: importing SciPy's took half of the front end's start."""

import cv2
import numpy as np
from numpy.typing import NDArray

KDTREE_SINGLE = 4  # FLANN's exact search, without random numbers
ALL_LEAVES = {"checks": -1}


def nearest_points(
    queries: NDArray[np.floating], points: NDArray[np.floating], count: int
) -> tuple[NDArray[np.float64], NDArray[np.intp]]:
    """Return the nearest points of each query, nearest first.

    Args:
        queries: (Q, 2) pixels.
        points: (N, 2) pixels, at least one.
        count: number K of neighbours, at most N.

    Returns:
        (Q, K) distances [px] and rows of `points`. The search is in float32: of points that are as far to 1e-4 px,
        any may be the last.
    """
    if len(queries) == 0:
        return np.zeros((0, count)), np.zeros((0, count), np.intp)
    tree = cv2.flann.Index(np.ascontiguousarray(points, np.float32), {"algorithm": KDTREE_SINGLE})
    rows = tree.knnSearch(np.ascontiguousarray(queries, np.float32), count, params=ALL_LEAVES)[0].astype(np.intp)
    distance = np.linalg.norm(points[rows] - queries[:, None].astype(np.float64), axis=2)
    order = np.argsort(distance, axis=1, kind="stable")
    return np.take_along_axis(distance, order, 1), np.take_along_axis(rows, order, 1)
