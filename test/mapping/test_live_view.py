# SPDX-License-Identifier: Apache-2.0
"""What a live view shows of a map: points and triangles tile by tile, so that only ground flown over costs anything."""

import numpy as np
import pytest

from uav_vslam.mapping import flown_map
from uav_vslam.mapping.flown_map import FlownMap
from uav_vslam.mapping.raster import Raster
from uav_vslam.mapping.summary import MapFrame
from uav_vslam.mapping.surface.grid import HeightGrid
from uav_vslam.mapping.surface.samples import CellSamples
from uav_vslam.mapping.tile_store import SIDE
from uav_vslam.mapping.triangles import surface_triangles

CELL_M = 0.5
FAR_M = 50_000.0  # a window from here to there would have 10^10 cells


def plane(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return 0.1 * x - 0.05 * y


def add_patch(grid: HeightGrid, raster: Raster) -> None:
    """Add heights of `plane` to all cells of a window."""
    rows, columns = (index.ravel() for index in np.indices(raster.shape))
    every = np.ones(len(rows), np.float32)
    height = plane(raster.x[columns], raster.y[rows]).astype(np.float32)
    grid.add(CellSamples(raster, rows, columns, height, 0.1 * every, every.astype(np.uint16), 0.1 * every))


@pytest.fixture
def patch() -> Raster:
    """A window over parts of four tiles."""
    return Raster(CELL_M, -40, SIDE - 30, 90, 75)


@pytest.mark.parametrize("stride", [1, 4, 7])
def test_triangles_cover_a_patch_once_across_the_edges_of_tiles(patch: Raster, stride: int) -> None:
    grid = HeightGrid(CELL_M)
    add_patch(grid, patch)
    assert grid.tiles == 4
    corners = surface_triangles(grid, stride * CELL_M)
    columns = len(range(-(-patch.column // stride) * stride, patch.column + patch.columns, stride))
    rows = len(range(-(-patch.row // stride) * stride, patch.row + patch.rows, stride))
    assert len(np.unique(corners.mean(axis=1), axis=0)) == len(corners) == 2 * (columns - 1) * (rows - 1)
    east, north, _ = (corners[:, 1:] - corners[:, :1]).transpose(2, 0, 1)
    areas = 0.5 * np.abs(east[:, 0] * north[:, 1] - east[:, 1] * north[:, 0])
    np.testing.assert_allclose(areas, 0.5 * (stride * CELL_M) ** 2)
    np.testing.assert_allclose(corners[..., 2], plane(corners[..., 0], corners[..., 1]), atol=1e-5)


def test_points_of_a_large_map_are_those_of_every_so_many_rows_and_columns(
    patch: Raster, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = FlownMap(None, MapFrame("uav1/map", north_up=True), cell_m=CELL_M, pixel_m=0.0)
    add_patch(found.grid, patch)
    everything, _ = found.coloured()
    assert (found.stride, len(everything)) == (1, patch.rows * patch.columns)
    monkeypatch.setattr(flown_map, "MOST_CELLS", SIDE**2)  # of four tiles
    assert found.stride == 2
    cells = np.floor(everything[:, :2] / CELL_M)
    expected = everything[(cells % 2 == 0).all(axis=1)]
    np.testing.assert_array_equal(found.coloured()[0], expected)


def test_ground_that_was_not_flown_over_costs_nothing() -> None:
    found = FlownMap(None, MapFrame("uav1/map", north_up=True), cell_m=CELL_M, pixel_m=0.0)
    for place_m in (0.0, FAR_M):
        add_patch(found.grid, Raster.covering([[place_m, place_m], [place_m + 9.0, place_m + 9.0]], CELL_M))
    points, _ = found.coloured()
    assert len(points) == 2 * 19**2
    assert np.ptp(points[:, 0]) > FAR_M
    assert len(surface_triangles(found.grid, CELL_M)) == 2 * 2 * 18**2
