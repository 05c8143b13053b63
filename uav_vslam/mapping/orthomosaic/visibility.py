# SPDX-License-Identifier: Apache-2.0
"""Which ground a camera sees past the things that stand on it.

From each cell a path runs towards the camera, over the ground, in equal steps. The cell is hidden if the surface is
higher somewhere along it than the ray to the camera. The walk ends at the camera, or where the ray is above all.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

from uav_vslam.mapping.raster import Raster

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

TOLERANCE_M = 0.3  # by which something must stick out over the ray, above the noise of heights
RIM_CELLS = 5  # side of what a hidden cell hides with it


def visible(raster: Raster, heights: NDArray[np.float32], camera_position: Array) -> Mask:
    """Return (rows, columns): whether the camera sees the centre of each cell.

    Args:
        raster: the cells; a step is as long as one.
        heights: (rows, columns) of the surface [m]; NaN hides nothing and counts as visible.
        camera_position: (3,) in the map frame [m].
    """
    if not np.isfinite(heights).any():
        return np.ones(raster.shape, bool)
    x, y = raster.x - camera_position[0], raster.y - camera_position[1]
    hidden = _hidden(heights, x, y, float(camera_position[2]), raster.cell_m).astype(np.uint8)
    return np.asarray(cv2.dilate(hidden, np.ones((RIM_CELLS, RIM_CELLS), np.uint8)) == 0)


def _hidden(heights: NDArray[np.float32], x: Array, y: Array, camera_height_m: float, step_m: float) -> Mask:
    """Return which cells are hidden; x, y are relative to the camera [m]."""
    highest = np.float32(np.nanmax(heights))
    blocking = np.where(np.isfinite(heights), heights, np.float32(-1e9))
    ground = np.where(np.isfinite(heights), heights, highest)
    away = np.hypot(x, y[:, None]).astype(np.float32)
    rise = (camera_height_m - ground) / np.maximum(away, np.float32(step_m))  # of the ray, per metre towards the camera
    towards_x = (-x / step_m).astype(np.float32) / np.maximum(away, 1e-6) * np.float32(step_m)
    towards_y = (-y[:, None] / step_m).astype(np.float32) / np.maximum(away, 1e-6) * np.float32(step_m)
    columns, rows = np.meshgrid(np.arange(len(x), dtype=np.float32), np.arange(len(y), dtype=np.float32))
    above_all_m = np.where(rise > 0.0, (highest - ground) / np.maximum(rise, 1e-6), np.inf)
    length_m = np.minimum(above_all_m, away).astype(np.float32)
    hidden = np.zeros(heights.shape, bool)
    for step in range(1, int(np.ceil(float(length_m.max()) / step_m)) + 1):
        met = cv2.remap(
            blocking,
            columns + step * towards_x,
            rows + step * towards_y,
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_REPLICATE,
        )
        walked_m = np.float32(step * step_m)
        hidden |= (met > ground + rise * walked_m + np.float32(TOLERANCE_M)) & (walked_m <= length_m)
    return hidden & np.isfinite(heights)
