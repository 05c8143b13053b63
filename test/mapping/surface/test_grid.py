# SPDX-License-Identifier: Apache-2.0
from pathlib import Path

import numpy as np
import pytest

from uav_vslam.errors import UavVslamError
from uav_vslam.mapping.raster import Raster
from uav_vslam.mapping.surface.grid import PART, HeightGrid
from uav_vslam.mapping.surface.samples import CellSamples
from uav_vslam.mapping.surface.tiles import CELL
from uav_vslam.mapping.tile_store import SIDE

AROUND = Raster(0.5, SIDE - 20, SIDE - 12, 40, 30)  # over the corner of four tiles


def samples(raster: Raster = AROUND, height: float | np.ndarray = 1.0, sigma: float = 0.1, where=None) -> CellSamples:
    rows, columns = np.nonzero(np.ones(raster.shape, bool) if where is None else where)
    values = np.broadcast_to(height, raster.shape)[rows, columns].astype(np.float32)
    return CellSamples(
        raster,
        rows,
        columns,
        values,
        np.full(len(rows), sigma, np.float32),
        np.full(len(rows), 25),
        np.full(len(rows), 0.2, np.float32),
    )


def wavy(raster: Raster) -> np.ndarray:
    return np.sin(raster.x / 3.0) + 0.1 * raster.y[:, None]


def test_heights_come_back_over_the_seams_of_tiles() -> None:
    grid = HeightGrid(0.5)
    grid.add(samples(height=wavy(AROUND)))
    window = grid.window(AROUND)
    assert window.height == pytest.approx(wavy(AROUND), abs=1e-5)
    assert (window.count == 25).all()
    assert window.sigma == pytest.approx(0.1, rel=1e-5)
    assert not window.filled.any()
    assert grid.extent == AROUND


def test_pairs_are_averaged_by_their_information() -> None:
    grid = HeightGrid(0.5)
    grid.add(samples(height=1.0, sigma=0.1))
    grid.add(samples(height=1.3, sigma=0.2))
    window = grid.window(AROUND)
    assert window.height == pytest.approx((1.0 / 0.01 + 1.3 / 0.04) / (1.0 / 0.01 + 1.0 / 0.04), abs=1e-5)
    assert window.sigma == pytest.approx((1.0 / 0.01 + 1.0 / 0.04) ** -0.5, rel=1e-4)


def test_the_order_of_pairs_that_agree_does_not_matter() -> None:
    rng = np.random.default_rng(1)
    pairs = [samples(height=wavy(AROUND) + rng.normal(0.0, 0.05), sigma=0.1 + 0.02 * k) for k in range(6)]
    grids = [HeightGrid(0.5), HeightGrid(0.5)]
    for grid, order in zip(grids, (range(6), rng.permutation(6)), strict=True):
        for k in order:
            grid.add(pairs[k])
    assert grids[0].height(AROUND) == pytest.approx(grids[1].height(AROUND), abs=1e-5)


@pytest.mark.parametrize(("ground", "roof", "expected"), [(2, 1, 6.0), (3, 1, 0.0), (1, 3, 6.0), (4, 2, 6.0)])
def test_what_stands_wins_with_half_as_many_pairs(ground: int, roof: int, expected: float) -> None:
    for order in ([0.0] * ground + [6.0] * roof, [6.0] * roof + [0.0] * ground):
        grid = HeightGrid(0.5)
        for height in order:
            grid.add(samples(height=height))
        assert grid.height(AROUND) == pytest.approx(expected, abs=1e-5)


def test_a_third_height_replaces_only_what_others_contradict() -> None:
    grid = HeightGrid(0.5)
    for height in (0.0, 0.0, 30.0, 6.0, 6.0, 6.0):
        grid.add(samples(height=height))
    assert grid.height(AROUND) == pytest.approx(6.0, abs=1e-5)


def test_gaps_up_to_three_metres_are_filled_and_flagged_and_wider_ones_not() -> None:
    known = np.ones(AROUND.shape, bool)
    known[:, 5:11] = False  # 3 m
    known[:, 20:29] = False  # 4.5 m
    grid = HeightGrid(0.5)
    grid.add(samples(height=2.0, where=known))
    window = grid.window(AROUND)
    inner = slice(3, -3)  # at the edge of the map a gap is open
    assert window.height[inner, 5:11] == pytest.approx(2.0)
    assert window.filled[inner, 5:11].all()
    assert np.isnan(window.sigma[:, 5:11]).all()
    assert not window.filled[known].any()
    assert np.isnan(window.height[:, 20:29]).all()


def test_a_gap_beside_a_wall_is_ground() -> None:
    known = np.ones(AROUND.shape, bool)
    known[:, 10:13] = False
    grid = HeightGrid(0.5)
    grid.add(samples(height=np.where(np.arange(40) < 10, 6.0, 1.0) + np.zeros((30, 1)), where=known))
    assert grid.height(AROUND)[3:-3, 10:13] == pytest.approx(1.0, abs=1e-4)


def test_a_window_does_not_change_what_is_in_it() -> None:
    rng = np.random.default_rng(2)
    grid = HeightGrid(0.5)
    grid.add(samples(height=wavy(AROUND), where=rng.uniform(size=AROUND.shape) > 0.4))
    whole = grid.window(AROUND)
    part = Raster(0.5, AROUND.column + 7, AROUND.row + 5, 11, 9)
    cut = part.within(AROUND)
    assert np.array_equal(grid.height(part), whole.height[cut], equal_nan=True)
    assert np.array_equal(grid.window(part).filled, whole.filled[cut])


def test_a_large_window_made_of_parts_is_as_one_made_at_once() -> None:
    large = Raster(0.5, -PART - 9, PART - 11, 2 * PART + 30, PART + 40)
    rng = np.random.default_rng(4)
    grid = HeightGrid(0.5)
    where = (rng.uniform(size=large.shape) > 0.4) & (np.arange(large.rows)[:, None] < 60)  # parts are unknown
    grid.add(samples(large, height=wavy(large), where=where))
    once, parts = grid._part(large), grid.window(large)
    for name in ("height", "sigma", "count", "angle", "filled"):
        np.testing.assert_array_equal(getattr(parts, name), getattr(once, name))
    np.testing.assert_array_equal(grid.height(large), once.height)
    assert once.filled.any()
    assert 0 < sum(part.raster.columns * part.raster.rows for part in grid.parts(large)) <= large.columns * large.rows


def test_tiles_in_memory_are_bounded_and_nothing_is_lost(tmp_path: Path) -> None:
    grid = HeightGrid(0.5, tmp_path / "tiles", most_bytes=3 * SIDE * SIDE * CELL.itemsize)
    reference = HeightGrid(0.5)
    rng = np.random.default_rng(3)
    for k in range(24):  # to and fro over eight tiles
        raster = Raster(0.5, 100 + (k * 5) % 8 * SIDE, 7 * k, 60, 50)
        pair = samples(raster, height=float(rng.normal(0.0, 0.05)))
        grid.add(pair)
        reference.add(pair)
        assert grid._tiles.in_memory <= 3
    assert reference._tiles.in_memory > 6
    everything = reference.extent
    assert grid.extent == everything
    grid.flush()
    assert HeightGrid.open(tmp_path / "tiles").extent == everything  # which looks at every cell
    assert np.array_equal(grid.height(everything), reference.height(everything), equal_nan=True)


def test_the_extent_of_a_growing_grid_needs_no_tile(tmp_path: Path) -> None:
    grid = HeightGrid(0.5, tmp_path / "tiles", most_bytes=1)
    whole = AROUND
    for k in range(4):
        raster = Raster(0.5, AROUND.column + 300 * k, AROUND.row - 200 * k, 40, 30)
        grid.add(samples(raster))
        whole = whole.union(raster)
    for path in (tmp_path / "tiles").glob("*.npz"):
        path.unlink()
    assert grid.extent == whole


def test_a_grid_is_read_back_from_its_folder(tmp_path: Path) -> None:
    grid = HeightGrid(0.25, tmp_path)
    raster = Raster(0.25, -300, -20, 50, 40)
    grid.add(samples(raster, height=wavy(raster)))
    grid.flush()
    again = HeightGrid.open(tmp_path)
    assert again.cell_m == 0.25
    assert again.extent == raster
    assert np.array_equal(again.height(raster), grid.height(raster))
    again.add(samples(raster, height=wavy(raster)))
    again.flush()
    assert (HeightGrid.open(tmp_path).window(raster).count == 50).all()


def test_known_tells_cells_of_their_own_height() -> None:
    grid = HeightGrid(0.5)
    grid.add(samples())
    west, south, east, north = AROUND.bounds_m
    inside, outside = [[west + 0.1, south + 0.1], [east - 0.1, north - 0.1]], [[west - 0.1, south], [east + 0.1, north]]
    assert grid.known(np.array(inside)).all()
    assert not grid.known(np.array(outside)).any()
    assert grid.known(np.zeros((0, 2))).shape == (0,)


def test_an_empty_grid_is_unknown_everywhere() -> None:
    grid = HeightGrid(0.5)
    assert np.isnan(grid.height(AROUND)).all()
    assert grid.extent.shape == (0, 0)
    assert grid.height(grid.extent).shape == (0, 0)


def test_wrong_cells_and_folders_are_refused(tmp_path: Path) -> None:
    with pytest.raises(UavVslamError, match="positive"):
        HeightGrid(0.0)
    with pytest.raises(UavVslamError, match=r"0\.25 m cells"):
        HeightGrid(0.5).height(Raster(0.25, 0, 0, 2, 2))
    with pytest.raises(UavVslamError, match="can't be read"):
        HeightGrid.open(tmp_path)
    HeightGrid(0.5, tmp_path / "tiles").flush()
    with pytest.raises(UavVslamError, match="already holds"):
        HeightGrid(0.5, tmp_path / "tiles")
