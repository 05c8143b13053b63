# SPDX-License-Identifier: Apache-2.0
"""The files of a surface take the memory of what was flown over, not of the square around it."""

import tracemalloc
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import tifffile

from uav_vslam.geometry.camera import PinholeCamera
from uav_vslam.geometry.pose import Pose
from uav_vslam.mapping.overlap import Overlap
from uav_vslam.mapping.raster import Raster
from uav_vslam.mapping.summary import MapFrame
from uav_vslam.mapping.surface.grid import HeightGrid
from uav_vslam.mapping.surface.samples import CellSamples
from uav_vslam.mapping.surface_files import write_surface

CELL_M, SPACING_M, VIEWS = 0.5, 100.0, 15
CAMERA = PinholeCamera(fx=640.0, fy=640.0, cx=320.0, cy=240.0, width=640, height=480)
DOWN = np.diag([1.0, -1.0, -1.0])


def flown_to_the_north_east() -> tuple[HeightGrid, Overlap]:
    """Return patches along the diagonal, as a vehicle that maps now and then leaves them."""
    grid, overlap = HeightGrid(CELL_M), Overlap()
    for at_m in SPACING_M * np.arange(VIEWS):
        raster = Raster.covering([[at_m - 20.0, at_m - 20.0], [at_m + 20.0, at_m + 20.0]], CELL_M)
        known = np.random.default_rng(int(at_m)).uniform(size=raster.shape) < 0.8
        rows, columns = np.nonzero(known)
        sigma, angle = (np.full(len(rows), value, np.float32) for value in (0.1, 0.2))
        height = np.sin(columns / 9.0).astype(np.float32)
        grid.add(CellSamples(raster, rows, columns, height, sigma, np.full(len(rows), 25), angle))
        overlap.views.append((CAMERA, Pose(DOWN, np.array([at_m, at_m, 60.0]))))
    return grid, overlap


@dataclass(frozen=True)
class Written:
    """The files of a flight to the north-east, and the most memory that they took."""

    grid: HeightGrid
    overlap: Overlap
    folder: Path
    surface: dict[str, Any]
    most_bytes: int


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Written:
    grid, overlap = flown_to_the_north_east()
    mapper: Any = SimpleNamespace(views={"uav1": VIEWS}, pairs=VIEWS, refused=Counter())
    folder = tmp_path_factory.mktemp("surface")
    tracemalloc.start()
    try:
        tree = write_surface(grid, overlap, mapper, folder, MapFrame("uav1/map", north_up=True))
        _, most_bytes = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    return Written(grid, overlap, folder, tree["surface"], most_bytes)


def test_a_long_straight_flight_takes_a_few_bytes_for_each_cell_of_the_square_around_it(written: Written) -> None:
    cells = written.grid.extent.columns * written.grid.extent.rows
    assert cells > 8e6
    assert written.most_bytes < 15 * cells  # the heights alone take 4 bytes a cell, all that is known of them 15


def test_height_tif_and_the_figures_hold_what_the_grid_knows(written: Written) -> None:
    surface, window = written.surface, written.grid.window(written.grid.extent)
    bands = window.height, window.sigma, window.count, window.angle, window.filled
    for band, values in zip(tifffile.imread(written.folder / "height.tif"), bands, strict=True):
        np.testing.assert_array_equal(band[::-1], values)
    known = np.isfinite(window.height)
    assert surface["cells"] == known.sum() > 0
    assert surface["filled"] == window.filled.sum() / known.sum() > 0.0
    assert surface["median_sigma_m"] == np.nanmedian(window.sigma)
    assert surface["height_m"] == [np.nanmin(window.height), np.nanmax(window.height)]
    shown_on, views = written.overlap.count(written.grid)
    shown = views > 0
    assert surface["coverage"] == (known & shown[written.grid.extent.within(shown_on)]).sum() / shown.sum()
