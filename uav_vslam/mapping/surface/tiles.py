# SPDX-License-Identifier: Apache-2.0
"""Square tiles of cells, of which only the latest used are in memory; the others are files of a folder."""

import json
from collections import OrderedDict
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from uav_vslam.errors import UavVslamError
from uav_vslam.mapping.raster import Raster

SIDE = 256  # cells
SURFACES = 2  # heights that a cell may have until views decide
CELL = np.dtype(
    [
        ("height", np.float32, SURFACES),  # of each surface [m]
        ("information", np.float32, SURFACES),  # of the heights [1/m^2]; 0 for a free place
        ("votes", np.uint16, SURFACES),  # pairs that saw it
        ("count", np.uint32),  # points of all pairs
        ("angle", np.float32),  # least view angle from the vertical [rad]
    ]
)
Tile = NDArray[np.void]
Key = tuple[int, int]  # row and column of a tile, in tiles

INDEX = "grid.json"
VERSION = 1


class TileStore:
    """Tiles by place; without a folder all stay in memory.

    Attributes:
        cell_m: side of a cell [m].
        most_bytes: that tiles in memory may take, where there is a folder.
    """

    def __init__(self, cell_m: float, folder: Path | None = None, *, most_bytes: int = 1 << 28) -> None:
        """Start an empty store; a folder is made, and may not hold tiles.

        Raises:
            UavVslamError: the folder holds tiles.
        """
        self.cell_m, self.most_bytes = cell_m, most_bytes
        self._folder = folder
        self._cached: OrderedDict[Key, Tile] = OrderedDict()
        self._changed: set[Key] = set()
        self._known: set[Key] = set()
        if folder is not None:
            folder.mkdir(parents=True, exist_ok=True)
            if (folder / INDEX).exists():
                raise UavVslamError(f"{folder} already holds a height grid; name another folder, or open that one")
            self.flush()

    @staticmethod
    def open(folder: Path, *, most_bytes: int = 1 << 28) -> "TileStore":
        """Return the store that was written to a folder.

        Raises:
            UavVslamError: there is none, or of another version.
        """
        try:
            index = json.loads((folder / INDEX).read_text(encoding="utf-8"))
        except (OSError, ValueError) as error:
            raise UavVslamError(
                f"{folder / INDEX} can't be read ({error}); name the folder `map/tiles` of a result"
            ) from None
        if index.get("version") != VERSION:
            raise UavVslamError(f"{folder / INDEX} has version {index.get('version')}, expected {VERSION}; map again")
        store = TileStore(float(index["cell_m"]), most_bytes=most_bytes)
        store._folder = folder
        store._known = {(row, column) for row, column in index["tiles"]}
        return store

    @property
    def keys(self) -> list[Key]:
        """Places of all tiles, sorted."""
        return sorted(self._known)

    @property
    def cached_bytes(self) -> int:
        """Memory of the tiles in memory."""
        return sum(tile.nbytes for tile in self._cached.values())

    def raster(self, key: Key) -> Raster:
        """Return the window of a tile."""
        return Raster(self.cell_m, key[1] * SIDE, key[0] * SIDE, SIDE, SIDE)

    def touching(self, raster: Raster) -> Iterator[tuple[Raster, Tile]]:
        """Yield the known tiles that touch a window."""
        for window in raster.tiles(SIDE):
            key = (window.row // SIDE, window.column // SIDE)
            if key in self._known:
                yield window, self._load(key)

    def for_change(self, key: Key) -> Tile:
        """Return a tile to be changed; a new one is empty."""
        if key not in self._known:
            self._known.add(key)
            self._cached[key] = _empty()
        tile = self._load(key)
        self._changed.add(key)
        self._make_room()
        return tile

    def flush(self) -> None:
        """Write the changed tiles and the index; nothing without a folder."""
        if self._folder is None:
            return
        for key in sorted(self._changed):
            self._write(key)
        index = {"version": VERSION, "cell_m": self.cell_m, "side": SIDE, "tiles": [list(key) for key in self.keys]}
        (self._folder / INDEX).write_text(json.dumps(index) + "\n", encoding="utf-8")

    def _load(self, key: Key) -> Tile:
        if key not in self._cached:
            assert self._folder is not None  # without a folder no tile leaves the memory
            self._cached[key] = np.load(self._path(self._folder, key))["cells"]
            self._make_room()
        self._cached.move_to_end(key)
        return self._cached[key]

    def _make_room(self) -> None:
        """Write and forget the tiles that were not used for longest; the latest one stays."""
        if self._folder is None:
            return
        while len(self._cached) > 1 and len(self._cached) * SIDE * SIDE * CELL.itemsize > self.most_bytes:
            key = next(iter(self._cached))
            if key in self._changed:
                self._write(key)
            del self._cached[key]

    def _write(self, key: Key) -> None:
        assert self._folder is not None
        np.savez(self._path(self._folder, key), cells=self._cached[key])
        self._changed.discard(key)

    @staticmethod
    def _path(folder: Path, key: Key) -> Path:
        return folder / f"{key[0]}_{key[1]}.npz"


def _empty() -> Tile:
    tile = np.zeros((SIDE, SIDE), CELL)
    tile["angle"] = np.inf
    return tile
