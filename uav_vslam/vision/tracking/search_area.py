# SPDX-License-Identifier: Apache-2.0
"""The part of the image where new points are missing: mostly the ground that has just come into view."""

import numpy as np
from numpy.typing import NDArray

from uav_vslam.geometry.image_grid import CELLS_PER_AXIS

Array = NDArray[np.float64]

MOST = 0.6  # of the points missing; all of them are nearly everywhere, as tracks end everywhere
MARGIN = 0.25  # of a cell, around the area: detectors see nothing at an image's border


def search_area(tracked: Array, count: int, shape: tuple[int, ...]) -> tuple[slice, slice]:
    """Return the smallest rectangle of grid cells in which most of the new points are missing.

    Args:
        tracked: (N, 2) points tracked already [px].
        count: number of new ones wanted, at least 1.
        shape: (height, width) of the image [px].

    Returns:
        Rows and columns of the image.
    """
    missing = missing_points(tracked, count, shape)
    sums = np.zeros((CELLS_PER_AXIS + 1, CELLS_PER_AXIS + 1))
    sums[1:, 1:] = missing.cumsum(axis=0).cumsum(axis=1)
    first, last = np.triu_indices(CELLS_PER_AXIS + 1, 1)
    of_rows = sums[last] - sums[first]
    found = of_rows[:, last] - of_rows[:, first]
    cells = np.outer(last - first, last - first)
    # Of equally small ones, the one with most.
    rows, columns = np.unravel_index(
        np.argmin(np.where(found >= MOST * count, cells - found / (2 * count), np.inf)), cells.shape
    )
    return _pixels(first[rows], last[rows], shape[0]), _pixels(first[columns], last[columns], shape[1])


def whole(shape: tuple[int, ...]) -> tuple[slice, slice]:
    """Return the rows and columns of the whole image of (height, width)."""
    return slice(0, shape[0]), slice(0, shape[1])


def missing_points(tracked: Array, count: int, shape: tuple[int, ...]) -> Array:
    """Return the number of new points for each cell, (rows, columns), that fills the emptiest cells to one level."""
    bounds = ((0.0, shape[0]), (0.0, shape[1]))
    present, *_ = np.histogram2d(tracked[:, 1], tracked[:, 0], bins=CELLS_PER_AXIS, range=bounds)
    lowest = np.sort(present, axis=None)
    level = np.min((count + np.cumsum(lowest)) / np.arange(1, len(lowest) + 1))
    return np.asarray(np.maximum(level - present, 0.0))


def _pixels(first: int, last: int, size: int) -> slice:
    cell = size / CELLS_PER_AXIS
    return slice(max(0, round((first - MARGIN) * cell)), min(size, round((last + MARGIN) * cell)))
