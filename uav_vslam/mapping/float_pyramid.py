# SPDX-License-Identifier: Apache-2.0
"""The tiles of a float32 raster and of its overviews, compressed as they come: the whole is never in memory."""

import math
import zlib
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float32]

TILE_PX = 256


class FloatPyramid:
    """Levels of a raster of several bands, each of every second row and column of the one before, down to one tile.

    A level takes its tiles from the four below them as soon as these are complete. NaN is no data.
    """

    def __init__(self, shape: tuple[int, int], bands: int) -> None:
        """Start without tiles; the shape is (rows, columns)."""
        self._shapes, self._bands = [shape], bands
        while max(self._shapes[-1]) > TILE_PX:
            rows, columns = self._shapes[-1]
            self._shapes.append((-(-rows // 2), -(-columns // 2)))
        self._packed: list[dict[tuple[int, int], list[bytes]]] = [{} for _ in self._shapes]
        self._growing: list[dict[tuple[int, int], Floats]] = [{} for _ in self._shapes]

    @property
    def places(self) -> Iterator[tuple[int, int]]:
        """Row and column of each tile of the raster, in the order in which they are to be added."""
        rows, columns = self._tiles(0)
        return ((row, column) for row in range(rows) for column in range(columns))

    def add(self, row: int, column: int, bands: Sequence[NDArray[np.generic]]) -> None:
        """Add the next tile, (rows, columns) of each band."""
        tile = self._empty()
        for band, values in zip(tile, bands, strict=True):
            band[: values.shape[0], : values.shape[1]] = values
        self._add(0, row, column, tile)

    def levels(self) -> Iterator[tuple[tuple[int, int], Iterator[bytes]]]:
        """Yield the shape of each level and its compressed tiles, band by band, row by row."""
        for level, shape in enumerate(self._shapes):
            yield shape, self._ordered(level)

    def _ordered(self, level: int) -> Iterator[bytes]:
        rows, columns = self._tiles(level)
        for band in range(self._bands):
            for row in range(rows):
                for column in range(columns):
                    yield self._packed[level][row, column][band]

    def _add(self, level: int, row: int, column: int, tile: Floats) -> None:
        self._packed[level][row, column] = [zlib.compress(np.ascontiguousarray(band, "<f4").tobytes()) for band in tile]
        if level + 1 == len(self._shapes):
            return
        above, half = (row // 2, column // 2), TILE_PX // 2
        growing = self._growing[level + 1]
        if above not in growing:
            growing[above] = self._empty()
        top, left = row % 2 * half, column % 2 * half
        growing[above][:, top : top + half, left : left + half] = tile[:, ::2, ::2]
        rows, columns = self._tiles(level)
        if (row % 2 or row == rows - 1) and (column % 2 or column == columns - 1):
            self._add(level + 1, *above, growing.pop(above))

    def _tiles(self, level: int) -> tuple[int, int]:
        rows, columns = self._shapes[level]
        return math.ceil(rows / TILE_PX), math.ceil(columns / TILE_PX)

    def _empty(self) -> Floats:
        return np.full((self._bands, TILE_PX, TILE_PX), np.nan, np.float32)
