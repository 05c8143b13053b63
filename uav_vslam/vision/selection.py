# SPDX-License-Identifier: Apache-2.0
"""Chooses points that are strong and spread over the image."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

CELLS = 100  # about so many square cells cover the image


def spread_selection(
    pixels: ArrayLike, strength: ArrayLike, *, size: tuple[int, int], count: int, cells: int = CELLS
) -> NDArray[np.intp]:
    """Return the strongest point of each cell, then the second of each, until there are enough.

    Args:
        pixels: (N, 2) u, v [px].
        strength: (N,) larger is better.
        size: width and height of the image [px].
        count: points wanted.
        cells: cells the image is divided into, about.

    Returns:
        (min(N, count),) ascending indices.
    """
    uv = np.asarray(pixels, float).reshape(-1, 2)
    if len(uv) <= count:
        return np.arange(len(uv))
    side = np.sqrt(size[0] * size[1] / cells)
    columns, rows = np.floor(uv / side).astype(np.int64).T
    rank = _rank_in_cell(rows * (int(np.abs(columns).max()) + 1) * 2 + columns, np.asarray(strength, float))
    order = np.lexsort((-np.asarray(strength, float), rank))
    return np.sort(order[:count])


def _rank_in_cell(cell: NDArray[np.int64], strength: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return each point's place in its own cell: 0 is the strongest."""
    order = np.lexsort((-strength, cell))
    starts = np.flatnonzero(np.diff(cell[order], prepend=cell[order][0] - 1))
    group = np.repeat(np.arange(len(starts)), np.diff(np.append(starts, len(cell))))
    rank = np.empty(len(cell), np.int64)
    rank[order] = np.arange(len(cell)) - starts[group]
    return rank
