# SPDX-License-Identifier: Apache-2.0
"""The tiles of the height grid, and the folder in which they outlive the process."""

import json
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from uav_vslam.errors import UavVslamError
from uav_vslam.mapping.tile_store import KEPT_BYTES, SIDE, TileStore

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

TILES = "tiles"  # the folder of a map that holds them
INDEX = "grid.json"
VERSION = 1


def require_no_grid(folder: Path) -> None:
    """Refuse a folder that holds a grid.

    Raises:
        UavVslamError: it does.
    """
    if (folder / INDEX).exists():
        raise UavVslamError(f"{folder} already holds a height grid; name another folder, or open that one")


class GridTiles(TileStore[Tile]):
    """Tiles of cells, `CELL`."""

    def __init__(self, cell_m: float, folder: Path | None = None, *, most_bytes: int = KEPT_BYTES) -> None:
        """Start an empty store; a folder is made, and may not hold tiles.

        Raises:
            UavVslamError: the folder holds tiles.
        """
        super().__init__(cell_m, folder, most_tiles=max(1, most_bytes // (SIDE * SIDE * CELL.itemsize)))
        if folder is not None:
            require_no_grid(folder)
            self.flush()

    @staticmethod
    def open(folder: Path) -> "GridTiles":
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
        store = GridTiles(float(index["cell_m"]))
        store._folder = folder
        store._known = {(row, column) for row, column in index["tiles"]}
        return store

    def flush(self) -> None:
        """Write the changed tiles and the index; nothing without a folder."""
        super().flush()
        if self._folder is not None:
            tiles = [list(key) for key in sorted(self._known)]
            index = {"version": VERSION, "cell_m": self.cell_m, "side": SIDE, "tiles": tiles}
            (self._folder / INDEX).write_text(json.dumps(index) + "\n", encoding="utf-8")

    def _empty(self) -> Tile:
        tile = np.zeros((SIDE, SIDE), CELL)
        tile["angle"] = np.inf
        return tile

    def _write(self, tile: Tile, path: Path) -> None:
        np.savez(path, cells=tile)

    def _read(self, path: Path) -> Tile:
        with np.load(path) as arrays:
            return np.asarray(arrays["cells"])
