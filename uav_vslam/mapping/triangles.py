# SPDX-License-Identifier: Apache-2.0
"""A coarse, regular mesh of the surface, for live views."""

import numpy as np
from numpy.typing import NDArray

from uav_vslam.mapping.surface.grid import HeightGrid

Array = NDArray[np.float64]


def surface_triangles(grid: HeightGrid, step_m: float) -> Array:
    """Return (N, 3, 3) corners of triangles between every so many cells [m]; none where a height is unknown."""
    window = grid.window(grid.extent)
    stride = max(1, round(step_m / grid.cell_m))
    x, y = np.meshgrid(window.raster.x[::stride], window.raster.y[::stride])
    points = np.dstack([x, y, window.height[::stride, ::stride].astype(float)])
    south_west, south_east = points[:-1, :-1], points[:-1, 1:]
    north_west, north_east = points[1:, :-1], points[1:, 1:]
    halves = [(south_west, south_east, north_east), (south_west, north_east, north_west)]
    corners = np.concatenate([np.stack(half, axis=2).reshape(-1, 3, 3) for half in halves])
    return np.asarray(corners[np.isfinite(corners).all(axis=(1, 2))])
