# SPDX-License-Identifier: Apache-2.0
"""Selection of points spread over the image."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

CELLS_PER_AXIS = 8


def spread(pixels: ArrayLike, count: int, *, size: tuple[float, float], taken: ArrayLike = ()) -> NDArray[np.intp]:
    """Select points round-robin over grid cells: the first of each cell, then the second of each, and so on.

    Args:
        pixels: (N, 2) points in order of preference [px].
        count: number of points wanted.
        size: width and height of the area, usually of the image [px].
        taken: (M, 2) points selected before; they count towards their cells.

    Returns:
        (min(N, count),) rows, the best of the emptiest cells first.
    """
    points = np.asarray(pixels, dtype=float).reshape(-1, 2)
    before = np.asarray(taken, dtype=float).reshape(-1, 2)
    cells = np.concatenate([_cells(before, size), _cells(points, size)])
    order = np.argsort(cells, kind="stable")
    ordered = cells[order]
    first_of_cell = np.searchsorted(ordered, ordered)
    rank = np.empty(len(cells), np.intp)
    rank[order] = np.arange(len(cells)) - first_of_cell
    return np.argsort(rank[len(before) :], kind="stable")[:count]


def spread_after(
    positions: NDArray[np.float64], first: NDArray[np.intp], others: NDArray[np.intp], count: int
) -> NDArray[np.intp]:
    """Return up to `count` rows of (N, 3) points [m]: those that go first, then others, each spread over the ground."""
    chosen = first[_spread_on_ground(positions[first], count)]
    return np.concatenate([chosen, others[_spread_on_ground(positions[others], count - len(chosen))]])


def ground_plan(positions: NDArray[np.float64]) -> tuple[NDArray[np.float64], tuple[float, float]]:
    """Return (N, 2) ground coordinates of (N, 3) points and the size of their area [m], as `spread` takes them."""
    plan = positions[:, :2] - positions[:, :2].min(axis=0, initial=np.inf)
    extent = np.maximum(plan.max(axis=0, initial=0.0), 1e-3)
    return plan, (float(extent[0]), float(extent[1]))


def _spread_on_ground(positions: NDArray[np.float64], count: int) -> NDArray[np.intp]:
    """Select `count` of (N, 3) points [m] as `spread` does, over the ground they cover; all if there are no more."""
    if len(positions) <= count:
        return np.arange(len(positions))
    plan, size = ground_plan(positions)
    return spread(plan, count, size=size)


def _cells(points: NDArray[np.float64], size: tuple[float, float]) -> NDArray[np.intp]:
    index = np.floor(points / np.asarray(size, dtype=float) * CELLS_PER_AXIS).astype(np.intp)
    index = np.clip(index, 0, CELLS_PER_AXIS - 1)
    return np.asarray(index[:, 0] * CELLS_PER_AXIS + index[:, 1])
