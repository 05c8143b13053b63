# SPDX-License-Identifier: Apache-2.0
"""Square tiles of a map, of which only the latest used are in memory; the others are files of a folder."""

from abc import ABC, abstractmethod
from collections import OrderedDict
from collections.abc import Iterator
from pathlib import Path
from typing import Generic, TypeVar

from uav_vslam.mapping.raster import Raster

SIDE = 256  # cells; the mosaic needs a multiple of 2^LEVELS
KEPT_BYTES = 1 << 28  # usual size of the tiles in memory

Tile = TypeVar("Tile")
Key = tuple[int, int]  # row and column of a tile, in tiles


class TileStore(ABC, Generic[Tile]):
    """Tiles by their window; without a folder all stay in memory.

    Attributes:
        cell_m: side of a cell [m].
        touched: tiles handed out since the start.
    """

    SUFFIX = ".npz"  # of the files

    def __init__(self, cell_m: float, folder: Path | None, *, most_tiles: int) -> None:
        """Start an empty store.

        Args:
            cell_m: side of a cell [m].
            folder: for tiles that are not in use; it is made if need be.
            most_tiles: in memory, where there is a folder.
        """
        self.cell_m, self.touched = cell_m, 0
        self._folder, self._most_tiles = folder, most_tiles
        self._cached: OrderedDict[Key, Tile] = OrderedDict()
        self._known: set[Key] = set()
        self._changed: set[Key] = set()
        if folder is not None:
            folder.mkdir(parents=True, exist_ok=True)

    @property
    def in_memory(self) -> int:
        """Number of tiles in memory."""
        return len(self._cached)

    def __len__(self) -> int:
        return len(self._known)

    def __iter__(self) -> Iterator[tuple[Raster, Tile]]:
        """Yield all tiles that exist with their windows, from south to north and west to east, to be read."""
        for key in sorted(self._known):
            yield Raster(self.cell_m, key[1] * SIDE, key[0] * SIDE, SIDE, SIDE), self._use(key)

    def touching(self, raster: Raster) -> Iterator[tuple[Raster, Tile]]:
        """Yield the tiles that touch a window, with their own ones, to be read."""
        for window in raster.tiles(SIDE):
            if _key(window) in self._known:
                yield window, self._use(_key(window))

    def touches(self, raster: Raster) -> bool:
        """Return whether some tile exists that touches a window."""
        return any(_key(window) in self._known for window in raster.tiles(SIDE))

    def change(self, window: Raster) -> Tile:
        """Return the tile of a window, to be changed in place; a new one is empty."""
        key = _key(window)
        if key not in self._known:
            self._known.add(key)
            self._cached[key] = self._empty()
        self._changed.add(key)
        return self._use(key)

    def flush(self) -> None:
        """Write the changed tiles; nothing without a folder."""
        for key in sorted(self._changed) if self._folder else ():
            self._save(key)

    @abstractmethod
    def _empty(self) -> Tile:
        """Return a tile that nothing is known of."""

    @abstractmethod
    def _write(self, tile: Tile, path: Path) -> None:
        """Write a file."""

    @abstractmethod
    def _read(self, path: Path) -> Tile:
        """Read a file."""

    def _use(self, key: Key) -> Tile:
        """Return a tile from memory or its file; those that were not used for longest make room for it."""
        self.touched += 1
        if key not in self._cached:
            self._cached[key] = self._read(self._path(key))
        self._cached.move_to_end(key)
        while self._folder and len(self._cached) > self._most_tiles:
            oldest = next(iter(self._cached))
            if oldest in self._changed:
                self._save(oldest)
            del self._cached[oldest]
        return self._cached[key]

    def _save(self, key: Key) -> None:
        self._write(self._cached[key], self._path(key))
        self._changed.discard(key)

    def _path(self, key: Key) -> Path:
        assert self._folder is not None  # without a folder no tile leaves the memory
        return self._folder / f"{key[0]}_{key[1]}{self.SUFFIX}"


def _key(window: Raster) -> Key:
    return window.row // SIDE, window.column // SIDE
