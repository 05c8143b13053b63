# SPDX-License-Identifier: Apache-2.0
from pathlib import Path

from uav_vslam.mapping.raster import Raster
from uav_vslam.mapping.tile_store import SIDE, TileStore


class Numbers(TileStore[list[int]]):
    """Tiles of a number."""

    def _empty(self) -> list[int]:
        return [0]

    def _write(self, tile: list[int], path: Path) -> None:
        path.write_text(str(tile[0]))

    def _read(self, path: Path) -> list[int]:
        return [int(path.read_text())]


def window(column: int) -> Raster:
    return Raster(0.5, column * SIDE, 0, SIDE, SIDE)


def test_the_tiles_used_last_stay_in_memory_and_only_changes_are_written(tmp_path: Path) -> None:
    store = Numbers(0.5, tmp_path, most_tiles=2)
    for column in (0, 1):
        store.change(window(column))[0] = 7 + column
    assert [tile for _, tile in store.touching(window(0))] == [[7]]
    store.change(window(2))
    assert [path.name for path in tmp_path.iterdir()] == ["0_1.npz"]  # 0 was used after it
    store.flush()
    for path in tmp_path.iterdir():
        path.write_text("5")
    assert [tile[0] for _, tile in store] == [7, 5, 5]  # 0 was in memory still
    assert {path.read_text() for path in tmp_path.iterdir()} == {"5"}
    assert store.in_memory == 2
    assert len(store) == 3
