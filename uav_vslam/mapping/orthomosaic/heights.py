# SPDX-License-Identifier: Apache-2.0
"""What the orthomosaic needs to know of a surface."""

from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from uav_vslam.mapping.raster import Raster

Real = NDArray[np.float32]


class Heights(Protocol):
    """A surface over the map frame."""

    def height(self, raster: Raster) -> Real:
        """Return (rows, columns) heights at the centres of the cells of any size [m]; NaN where unknown."""
        ...


class Grid(Protocol):
    """A grid of heights, which knows only cells of its own size."""

    @property
    def cell_m(self) -> float:
        """Side of a cell [m]."""
        ...

    def height(self, raster: Raster) -> Real:
        """Return (rows, columns) heights of its own cells [m]; NaN where unknown."""
        ...


class GridHeights:
    """A grid of heights at any cell size: linear between its cells, and known where the nearest cell is."""

    def __init__(self, grid: Grid) -> None:
        self._grid = grid

    def height(self, raster: Raster) -> Real:
        """Return (rows, columns) heights [m]; NaN where unknown."""
        west, south, east, north = raster.bounds_m
        cell = self._grid.cell_m
        own = Raster.covering([[west - cell, south - cell], [east + cell, north + cell]], cell)
        heights = self._grid.height(own)
        known = np.isfinite(heights)
        at, border = own.under(raster), cv2.BORDER_REPLICATE
        weights = cv2.remap(known.astype(np.float32), *at, cv2.INTER_LINEAR, borderMode=border)
        total = cv2.remap(np.where(known, heights, np.float32(0.0)), *at, cv2.INTER_LINEAR, borderMode=border)
        nearest = cv2.remap(known.astype(np.float32), *at, cv2.INTER_NEAREST, borderMode=border) > 0
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(nearest & (weights > 0), total / weights, np.float32(np.nan))
