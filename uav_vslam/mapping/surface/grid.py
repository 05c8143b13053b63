# SPDX-License-Identifier: Apache-2.0
"""The height grid: what all pairs of all vehicles say about each cell, in tiles, most of them on disk.

A cell holds up to two surfaces, each with the information-weighted mean of the heights that agree and the number of
pairs behind it. The one that more pairs saw counts, but the higher one if at least half as many saw it: from some
side a wall hides what is below it, from none does the ground hide what stands on it. While a cell has one surface,
the order of the pairs changes nothing but the rounding.
"""

import dataclasses
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from uav_vslam.errors import UavVslamError
from uav_vslam.mapping.raster import Raster
from uav_vslam.mapping.surface.filling import fill, narrow_gaps
from uav_vslam.mapping.surface.samples import CellSamples
from uav_vslam.mapping.surface.tiles import CELL, GridTiles, Tile
from uav_vslam.mapping.tile_store import KEPT_BYTES, SIDE

Floats = NDArray[np.float32]

WIDEST_GAP_M = 3.0  # that is filled
AGREE_M, AGREE_SIGMAS = 0.5, 4.0  # two heights agree within the larger of both
TOP_VOTES = 0.5  # of the other surface's pairs that the higher one needs
MOST_POINTS = 65535
PART = 2 * SIDE  # cells, each way: larger windows are made of parts of this size


@dataclass(frozen=True, slots=True)
class HeightWindow:
    """The surface in a window; arrays are (rows, columns), south first.

    Attributes:
        raster: the window.
        height: [m], NaN unknown.
        sigma: standard deviation given the poses of the views [m], NaN unknown or filled.
        count: uint16 stereo points.
        angle: least view angle from the vertical [rad], NaN unknown or filled.
        filled: cells of gaps, whose height is that of the lower surface around them.
    """

    raster: Raster
    height: Floats
    sigma: Floats
    count: NDArray[np.uint16]
    angle: Floats
    filled: NDArray[np.bool_]

    @staticmethod
    def unknown(raster: Raster) -> "HeightWindow":
        """Return a window of which nothing is known."""
        nothing = [np.full(raster.shape, np.nan, np.float32) for _ in range(3)]
        count, filled = np.zeros(raster.shape, np.uint16), np.zeros(raster.shape, bool)
        return HeightWindow(raster, nothing[0], nothing[1], count, nothing[2], filled)

    def points(self, stride: int) -> NDArray[np.float64]:
        """Return (N, 3) centres of the cells with a height [m], of every so many rows and columns of the grid."""
        rows, columns = np.nonzero(np.isfinite(self.height))
        chosen = ((rows + self.raster.row) % stride == 0) & ((columns + self.raster.column) % stride == 0)
        rows, columns = rows[chosen], columns[chosen]
        return np.column_stack([self.raster.x[columns], self.raster.y[rows], self.height[rows, columns]])


class HeightGrid:
    """Heights on an unbounded grid."""

    def __init__(self, cell_m: float = 0.5, folder: Path | None = None, *, most_bytes: int = KEPT_BYTES) -> None:
        """Start an empty grid.

        Args:
            cell_m: side of a cell [m].
            folder: of the tiles; without one all stay in memory.
            most_bytes: of tiles in memory, where there is a folder.

        Raises:
            UavVslamError: the cell is empty, or the folder already holds a grid.
        """
        if not cell_m > 0.0:
            raise UavVslamError(f"cells of {cell_m} m are not possible; use a positive size, 0.5 m is usual")
        self._tiles = GridTiles(cell_m, folder, most_bytes=most_bytes)
        self._extent: Raster | None = Raster(cell_m, 0, 0, 0, 0)  # None: not known since `open`

    @staticmethod
    def open(folder: Path) -> "HeightGrid":
        """Return the grid that was written to a folder.

        Raises:
            UavVslamError: there is none.
        """
        store = GridTiles.open(folder)
        grid = HeightGrid(store.cell_m)
        grid._tiles, grid._extent = store, None
        return grid

    @property
    def cell_m(self) -> float:
        """Side of a cell [m]."""
        return self._tiles.cell_m

    @property
    def tiles(self) -> int:
        """Number of tiles that exist."""
        return len(self._tiles)

    @property
    def extent(self) -> Raster:
        """The smallest window that holds all known cells; of an opened grid, the first time reads every tile."""
        if self._extent is None:
            self._extent = Raster(self.cell_m, 0, 0, 0, 0)
            for window, tile in self._tiles:
                self._extent = self._extent.union(window.around(*np.nonzero(tile["votes"].any(axis=-1))))
        return self._extent

    def add(self, samples: CellSamples) -> None:
        """Add what a pair says.

        Raises:
            UavVslamError: its cells are of another size.
        """
        self._check(samples.raster)
        self._extent = self.extent.union(samples.raster.around(samples.rows, samples.columns))  # none is forgotten
        rows, columns = samples.rows + samples.raster.row, samples.columns + samples.raster.column
        for window in samples.raster.tiles(SIDE):
            inside = (rows >= window.row) & (rows < window.row + SIDE)
            inside &= (columns >= window.column) & (columns < window.column + SIDE)
            if inside.any():
                tile = self._tiles.change(window)
                _fuse(tile, (rows[inside] - window.row, columns[inside] - window.column), samples, inside)

    def height(self, raster: Raster) -> Floats:
        """Return the (rows, columns) heights of a window [m]: gaps up to 3 m filled, NaN unknown.

        Raises:
            UavVslamError: its cells are of another size.
        """
        self._check(raster)
        whole = np.full(raster.shape, np.nan, np.float32)
        for part in self.parts(raster):
            whole[part.raster.within(raster)] = part.height
        return whole

    def window(self, raster: Raster) -> HeightWindow:
        """Return all that is known of a window.

        Raises:
            UavVslamError: its cells are of another size.
        """
        self._check(raster)
        whole = HeightWindow.unknown(raster)
        for part in self.parts(raster):
            cut = part.raster.within(raster)
            for name in ("height", "sigma", "count", "angle", "filled"):
                getattr(whole, name)[cut] = getattr(part, name)
        return whole

    def parts(self, raster: Raster) -> Iterator[HeightWindow]:
        """Yield a window in parts of at most `PART` cells each way, without those of which nothing is known.

        Raises:
            UavVslamError: its cells are of another size.
        """
        self._check(raster)
        for block in raster.tiles(PART):
            part = block.intersection(raster)
            if self._tiles.touches(part.grown(self._reach + 1)):
                yield self._part(part)

    @property
    def _reach(self) -> int:
        """Width of the widest gap that is filled [cells]."""
        return round(WIDEST_GAP_M / self.cell_m)

    def _part(self, raster: Raster) -> HeightWindow:
        reach = self._reach
        # Gaps are filled alike in every window: those around it must be seen too.
        wide = raster.grown(3 * (reach + 1))
        cells = self._cells(wide)
        height, sigma = _chosen(cells)
        gaps = narrow_gaps(np.isfinite(height), reach)
        whole = fill(height, gaps, reach)
        cut = raster.within(wide)
        angle = np.where(np.isfinite(height), cells["angle"], np.nan).astype(np.float32)
        count = np.minimum(cells["count"], MOST_POINTS).astype(np.uint16)
        return HeightWindow(raster, whole[cut], sigma[cut], count[cut], angle[cut], (gaps & np.isfinite(whole))[cut])

    def windows(self, *, beyond: int = 0) -> Iterator[HeightWindow]:
        """Yield all that is known, tile by tile, each with so many rows and columns beyond its north and east edges.

        A window of the whole `extent` would take as much as the square around a long, straight flight.
        """
        for tile, _ in self._tiles:
            yield self.window(dataclasses.replace(tile, columns=tile.columns + beyond, rows=tile.rows + beyond))

    def known(self, xy: ArrayLike) -> NDArray[np.bool_]:
        """Return which of (N, 2) points x, y [m] lie in cells with a height of their own."""
        raster = Raster.covering(xy, self.cell_m)
        cell = np.floor(np.asarray(xy, dtype=float).reshape(-1, 2) / self.cell_m).astype(int)
        found = np.zeros(len(cell), bool)
        for window, tile in self._tiles.touching(raster):
            row, column = cell[:, 1] - window.row, cell[:, 0] - window.column
            inside = (row >= 0) & (row < SIDE) & (column >= 0) & (column < SIDE)
            found[inside] = tile["votes"][row[inside], column[inside]].any(axis=-1)
        return found

    def flush(self) -> None:
        """Write all changes to the folder."""
        self._tiles.flush()

    def _cells(self, raster: Raster) -> Tile:
        cells = np.zeros(raster.shape, CELL)
        for window, tile in self._tiles.touching(raster):
            common = raster.intersection(window)
            cells[common.within(raster)] = tile[common.within(window)]
        return cells

    def _check(self, raster: Raster) -> None:
        if raster.cell_m != self.cell_m:
            raise UavVslamError(f"a window of {raster.cell_m} m cells doesn't fit the grid's {self.cell_m} m cells")


def _chosen(cells: Tile) -> tuple[Floats, Floats]:
    """Return height and standard deviation of the surface that counts; NaN where there is none."""
    votes = cells["votes"].astype(np.float32)
    height, information = cells["height"], cells["information"]
    higher = np.where(height[..., 1] > height[..., 0], 1, 0)
    both = (votes > 0).all(axis=-1)
    top = np.where(both, higher, votes.argmax(axis=-1))[..., None]
    enough = np.take_along_axis(votes, top, -1) >= TOP_VOTES * np.take_along_axis(votes, 1 - top, -1)
    best = np.where(enough, top, 1 - top)
    weight = np.take_along_axis(information, best, -1)[..., 0]
    known = weight > 0.0
    sigma = np.where(known, 1.0 / np.sqrt(np.where(known, weight, 1.0)), np.nan)
    return np.where(known, np.take_along_axis(height, best, -1)[..., 0], np.nan), sigma


def _fuse(
    tile: Tile, place: tuple[NDArray[np.intp], NDArray[np.intp]], samples: CellSamples, chosen: NDArray[np.bool_]
) -> None:
    """Merge samples into their cells: with the surface that agrees, else on a free place or against the weaker one."""
    cells = tile[place]
    height, weight = samples.height[chosen], 1.0 / samples.sigma[chosen] ** 2
    slot, agrees = _slots(cells, height, weight)
    free = np.take_along_axis(cells["votes"], slot[:, None], 1)[:, 0] == 0
    row = np.arange(len(slot))
    old = np.where(agrees, cells["information"][row, slot], 0.0)
    joined = agrees | free
    total = old + weight
    mean = (old * cells["height"][row, slot] + weight * height) / total
    # A surface that another pair contradicts loses a vote, and its place with the last one.
    votes = cells["votes"][row, slot].astype(np.int64)
    lost = ~joined & (votes <= 1)
    taken = joined | lost
    cells["height"][row, slot] = np.where(taken, mean, cells["height"][row, slot])
    cells["information"][row, slot] = np.where(taken, total, cells["information"][row, slot])
    cells["votes"][row, slot] = np.where(joined, votes + 1, np.where(lost, 1, votes - 1)).clip(0, MOST_POINTS)
    cells["count"] += samples.count[chosen].astype(np.uint32)
    cells["angle"] = np.minimum(cells["angle"], samples.angle[chosen])
    tile[place] = cells


def _slots(cells: Tile, height: Floats, weight: Floats) -> tuple[NDArray[np.intp], NDArray[np.bool_]]:
    """Return (N,) the place of each sample in its cell, and whether the surface there agrees with it."""
    used = cells["votes"] > 0
    information = np.where(used, cells["information"], 1.0)
    sigma = np.sqrt(1.0 / weight[:, None] + 1.0 / information)
    apart = np.where(used, np.abs(cells["height"] - height[:, None]), np.inf)
    agree = apart <= np.maximum(AGREE_M, AGREE_SIGMAS * sigma)
    nearest = np.where(agree, apart, np.inf).argmin(axis=1)
    agrees = np.asarray(agree.any(axis=1))
    # The place with the fewest votes; a free one has none.
    weakest = cells["votes"].argmin(axis=1)
    return np.where(agrees, nearest, weakest), agrees
