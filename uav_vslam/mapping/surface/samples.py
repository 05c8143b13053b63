# SPDX-License-Identifier: Apache-2.0
"""What one pair says about each cell of the grid: the height of the highest surface that fills a good part of it.

Where a wall crosses a cell, its points are of two heights; their mean would be the height of neither.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from uav_vslam.mapping.raster import Raster
from uav_vslam.mapping.surface.stereo import PairPoints

Array = NDArray[np.float64]
Floats = NDArray[np.float32]

STEP_M = 0.6  # a gap between the heights in a cell that separates two surfaces
TOP_SHARE = 0.35  # of a cell's points that the higher surface needs: the view's edge pixels lean outwards
LEAST_POINTS = 4
LEAST_SHARE = 0.25  # of the points of a usual cell: stray matches are few
NEIGHBOURS = [(down, right) for down in (-1, 0, 1) for right in (-1, 0, 1) if (down, right) != (0, 0)]
CONFIRMED = 2  # neighbours of about the same height
SURROUNDED = 6  # lower neighbours of what stands alone
RESOLUTION_M = 0.005  # heights are sorted as integers
HEIGHT_BITS = 20  # of them, for a range of 5 km
SPREAD_SHARE = 0.7413  # half of the quartiles' distance of a normal distribution, as its standard deviation
INDEPENDENT = 2.0  # points of a cell that err independently: pixel locking and the block are common to all


@dataclass(frozen=True, slots=True)
class CellSamples:
    """Heights of some cells from one pair.

    Attributes:
        raster: the window.
        rows, columns: (N,) cells in it, each once.
        height, sigma: (N,) [m].
        count: (N,) points.
        angle: (N,) view angle from the vertical [rad].
    """

    raster: Raster
    rows: NDArray[np.intp]
    columns: NDArray[np.intp]
    height: Floats
    sigma: Floats
    count: NDArray[np.int64]
    angle: Floats


def sample(points: PairPoints, cell_m: float) -> CellSamples | None:
    """Reduce the points of a pair to one height a cell; None if there are too few."""
    raster = Raster.covering(points.points_map, cell_m)
    if raster.rows == 0:
        return None
    cells, heights, low_m = _sorted(points, raster)
    starts = np.flatnonzero(np.r_[True, (np.diff(cells) != 0) | (np.diff(heights) * RESOLUTION_M > STEP_M)])
    sizes = np.diff(np.r_[starts, len(cells)])
    owner = cells[starts]
    in_cell = np.bincount(owner, weights=sizes, minlength=raster.rows * raster.columns)
    least = max(LEAST_POINTS, LEAST_SHARE * float(np.median(in_cell[in_cell > 0])))
    fits = np.flatnonzero((in_cell[owner] >= least) & (sizes >= np.maximum(LEAST_POINTS, TOP_SHARE * in_cell[owner])))
    fits = fits[np.r_[owner[fits][1:] != owner[fits][:-1], True]] if len(fits) else fits  # the highest of each cell
    if len(fits) == 0:
        return None
    start, size = starts[fits], sizes[fits]
    height = low_m + RESOLUTION_M * heights[start + size // 2]
    spread = RESOLUTION_M * (heights[start + (3 * size) // 4] - heights[start + size // 4]) * SPREAD_SHARE
    rows, columns = np.divmod(owner[fits], raster.columns)
    sound = _sound(raster, rows, columns, height)
    rows, columns, height, spread, size = (each[sound] for each in (rows, columns, height, spread, size))
    lever = points.lever(np.column_stack([raster.x[columns], raster.y[rows], height]))
    noise_m = np.maximum(lever * points.noise_m, spread)
    sigma = np.sqrt((lever * points.pose_m) ** 2 + noise_m**2 / INDEPENDENT)
    across = np.hypot(raster.x[columns] - points.camera_map[0], raster.y[rows] - points.camera_map[1])
    angle = np.arctan2(across, points.camera_map[2] - height)
    return CellSamples(
        raster, rows, columns, height.astype(np.float32), sigma.astype(np.float32), size, angle.astype(np.float32)
    )


def _sound(raster: Raster, rows: NDArray[np.intp], columns: NDArray[np.intp], height: Array) -> NDArray[np.bool_]:
    """Return (N,) which cells two neighbours confirm, or rise from those around them: a lone pit is a mismatch."""
    padded = np.full((raster.rows + 2, raster.columns + 2), np.nan)
    padded[rows + 1, columns + 1] = height
    confirmed, below = np.zeros(len(height), int), np.zeros(len(height), int)
    for down, right in NEIGHBOURS:
        beside = padded[rows + 1 + down, columns + 1 + right]
        confirmed += np.abs(beside - height) < STEP_M + raster.cell_m  # slopes up to 45 degrees
        below += beside < height
    return np.asarray((confirmed >= CONFIRMED) | (below >= SURROUNDED))


def _sorted(points: PairPoints, raster: Raster) -> tuple[NDArray[np.int64], NDArray[np.int64], float]:
    """Return cell and height of each point, sorted by both; heights in steps of RESOLUTION_M above the lowest [m]."""
    x, y, z = points.points_map.T.astype(float)
    column = np.floor(x / raster.cell_m).astype(np.int64) - raster.column
    row = np.floor(y / raster.cell_m).astype(np.int64) - raster.row
    low_m = float(z.min())
    step = np.minimum((z - low_m) / RESOLUTION_M, (1 << HEIGHT_BITS) - 1).astype(np.int64)
    keys = np.sort(((row * raster.columns + column) << HEIGHT_BITS) | step)
    return keys >> HEIGHT_BITS, keys & ((1 << HEIGHT_BITS) - 1), low_m
