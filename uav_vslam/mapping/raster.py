# SPDX-License-Identifier: Apache-2.0
"""Windows of one unbounded grid of square cells over the map frame.

Cell (column, row) covers x from column * cell_m to (column + 1) * cell_m, and y likewise: columns east, rows north.
Arrays over a window therefore have south first; only files of pictures turn them over.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Raster:
    """A window of the grid.

    Attributes:
        cell_m: side of a cell [m].
        column, row: of the south-western cell.
        columns, rows: number of cells; 0 for an empty window.
    """

    cell_m: float
    column: int
    row: int
    columns: int
    rows: int

    @staticmethod
    def covering(points: ArrayLike, cell_m: float) -> "Raster":
        """Return the smallest window whose cells contain (N, 2 or more) points x, y [m]; empty without any."""
        points = np.asarray(points)
        if len(points) == 0:
            return Raster(cell_m, 0, 0, 0, 0)
        x, y = points[:, 0], points[:, 1]  # each by itself: numpy takes ten times as long for a minimum over rows
        west, east, south, north = (math.floor(float(end) / cell_m) for end in (x.min(), x.max(), y.min(), y.max()))
        return Raster(cell_m, west, south, east - west + 1, north - south + 1)

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, columns), as of arrays over the window."""
        return self.rows, self.columns

    @property
    def x(self) -> Array:
        """(columns,) centres [m]."""
        return np.asarray((self.column + np.arange(self.columns) + 0.5) * self.cell_m)

    @property
    def y(self) -> Array:
        """(rows,) centres [m]."""
        return np.asarray((self.row + np.arange(self.rows) + 0.5) * self.cell_m)

    @property
    def bounds_m(self) -> tuple[float, float, float, float]:
        """West, south, east and north edge [m]."""
        west, south = self.column * self.cell_m, self.row * self.cell_m
        return west, south, west + self.columns * self.cell_m, south + self.rows * self.cell_m

    def index(self, points: ArrayLike) -> tuple[Array, Array]:
        """Return fractional (row, column) of (..., 2 or more) points: whole at the centres of cells."""
        xy = np.asarray(points, dtype=float) / self.cell_m - 0.5
        return xy[..., 1] - self.row, xy[..., 0] - self.column

    def under(self, other: "Raster") -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return fractional (columns, rows) of this window below the centres of another's cells, for `cv2.remap`."""
        column, row = (one / self.cell_m - 0.5 - first for one, first in ((other.x, self.column), (other.y, self.row)))
        map_x, map_y = np.meshgrid(column.astype(np.float32), row.astype(np.float32))
        return map_x, map_y

    def intersection(self, other: "Raster") -> "Raster":
        """Return the common window of two of the same grid; empty (0 cells) if there is none."""
        column, row = max(self.column, other.column), max(self.row, other.row)
        columns = min(self.column + self.columns, other.column + other.columns) - column
        rows = min(self.row + self.rows, other.row + other.rows) - row
        return Raster(self.cell_m, column, row, max(0, columns), max(0, rows))

    def union(self, other: "Raster") -> "Raster":
        """Return the smallest window of the same grid that holds both; an empty one adds nothing."""
        if 0 in self.shape or 0 in other.shape:
            return other if 0 in self.shape else self
        column, row = min(self.column, other.column), min(self.row, other.row)
        columns = max(self.column + self.columns, other.column + other.columns) - column
        rows = max(self.row + self.rows, other.row + other.rows) - row
        return Raster(self.cell_m, column, row, columns, rows)

    def around(self, rows: NDArray[np.intp], columns: NDArray[np.intp]) -> "Raster":
        """Return the smallest window that holds (N,) cells of this one; empty without any."""
        if len(rows) == 0:
            return Raster(self.cell_m, 0, 0, 0, 0)
        row, column = int(rows.min()), int(columns.min())
        size = int(columns.max()) - column + 1, int(rows.max()) - row + 1
        return Raster(self.cell_m, self.column + column, self.row + row, *size)

    def with_cells(self, cell_m: float) -> "Raster":
        """Return the smallest window of cells of another size that covers this one."""
        west, south, east, north = self.bounds_m
        return Raster.covering([[west, south], [east - 1e-6, north - 1e-6]], cell_m)

    def grown(self, margin: int, *, align: int = 1) -> "Raster":
        """Return the smallest window with a margin [cells] around this one and edges at multiples of `align`."""
        column, row = ((start - margin) // align * align for start in (self.column, self.row))
        columns = -(-(self.column + self.columns + margin - column) // align) * align
        rows = -(-(self.row + self.rows + margin - row) // align) * align
        return Raster(self.cell_m, column, row, columns, rows)

    def within(self, other: "Raster") -> tuple[slice, slice]:
        """Return the slices (rows, columns) that cut this window from an array over `other`, which contains it."""
        row, column = self.row - other.row, self.column - other.column
        return slice(row, row + self.rows), slice(column, column + self.columns)

    def tiles(self, side: int) -> Iterator["Raster"]:
        """Yield the whole tiles, `side` cells each way and aligned to the grid's origin, that touch this window."""
        if self.rows == 0 or self.columns == 0:
            return
        for row in range(self.row // side, (self.row + self.rows - 1) // side + 1):
            for column in range(self.column // side, (self.column + self.columns - 1) // side + 1):
                yield Raster(self.cell_m, column * side, row * side, side, side)

    def blocks(self, side: int, *, align: int) -> Iterator["Raster"]:
        """Yield the fewest parts of at most `side` cells each way, about equal, of this window, which is not empty.

        Args:
            side: a multiple of `align`.
            align: a divisor of the window's edges, and of those of the parts.
        """
        height, width = (math.ceil(cells / math.ceil(cells / side) / align) * align for cells in self.shape)
        for row in range(self.row, self.row + self.rows, height):
            for column in range(self.column, self.column + self.columns, width):
                yield Raster(self.cell_m, column, row, width, height).intersection(self)
