# SPDX-License-Identifier: Apache-2.0
"""A coarse, regular mesh of the surface, for live views."""

import numpy as np
from numpy.typing import NDArray

from uav_vslam.mapping.surface.grid import HeightGrid, HeightWindow

Array = NDArray[np.float64]


def surface_triangles(grid: HeightGrid, step_m: float) -> Array:
    """Return (N, 3, 3) corners of triangles between every so many cells [m]; none where a height is unknown."""
    stride = max(1, round(step_m / grid.cell_m))
    parts = [_triangles(window, stride) for window in grid.windows(beyond=stride)]
    return np.concatenate([np.zeros((0, 3, 3)), *parts])


def _triangles(window: HeightWindow, stride: int) -> Array:
    """Return the triangles of a window, with corners in every so many rows and columns of the grid."""
    rows, columns = (
        slice(-window.raster.row % stride, None, stride),
        slice(-window.raster.column % stride, None, stride),
    )
    x, y = np.meshgrid(window.raster.x[columns], window.raster.y[rows])
    points = np.dstack([x, y, window.height[rows, columns].astype(float)])
    south_west, south_east = points[:-1, :-1], points[:-1, 1:]
    north_west, north_east = points[1:, :-1], points[1:, 1:]
    halves = [(south_west, south_east, north_east), (south_west, north_east, north_west)]
    corners = np.concatenate([np.stack(half, axis=2).reshape(-1, 3, 3) for half in halves])
    return np.asarray(corners[np.isfinite(corners).all(axis=(1, 2))])
