# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest

from uav_vslam.mapping.orthomosaic.visibility import visible
from uav_vslam.mapping.raster import Raster

RASTER = Raster(0.1, -300, -100, 600, 200)
X, Y = np.meshgrid(RASTER.x, RASTER.y)
FLAT = np.zeros(RASTER.shape, np.float32)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_wall_hides_the_strip_behind_it(side: float) -> None:
    """Camera 30 m above x = 0, a wall of 3 m from 10 to 11 m: the ray over its far top edge lands at 12.22 m."""
    heights = np.where((side * X > 10.0) & (side * X < 11.0), np.float32(3.0), FLAT)
    seen = visible(RASTER, heights, np.array([0.0, 0.0, 30.0]))
    assert seen[(side * X > -9.0) & (side * X < 9.6)].all()
    assert not seen[(side * X > 11.4) & (side * X < 11.8)].any()
    assert seen[(side * X > 12.8) & (side * X < 20.0)].all()


def test_slopes_and_plains_hide_nothing() -> None:
    camera = np.array([3.0, 1.0, 40.0])
    assert visible(RASTER, FLAT, camera).all()
    assert visible(RASTER, (0.2 * X + 0.1 * Y).astype(np.float32), camera).all()


def test_seen_from_above_everything_is_visible_but_a_pits_edge_hides_its_floor() -> None:
    pit = np.where((np.abs(X - 15.0) < 2.0) & (np.abs(Y) < 2.0), np.float32(-4.0), FLAT)
    seen = visible(RASTER, pit, np.array([0.0, 0.0, 30.0]))
    assert not seen[(np.abs(X - 13.6) < 0.3) & (np.abs(Y) < 1.5)].any()
    assert seen[(np.abs(X - 16.5) < 0.2) & (np.abs(Y) < 1.5)].all()
    assert visible(RASTER, pit, np.array([15.0, 0.0, 300.0]))[np.abs(Y) < 1.5].mean() > 0.99


def test_a_hill_higher_than_the_camera_hides_nothing_on_the_camera_s_other_side() -> None:
    hill = np.where(X > 20.0, np.float32(15.0), FLAT)
    seen = visible(RASTER, hill, np.array([10.0, 0.0, 8.0]))
    assert seen[X < 19.5].all()


def test_a_wall_hides_the_hill_behind_it_that_is_higher_than_the_camera() -> None:
    heights = np.where(X > 20.0, np.float32(15.0), np.where((X > 14.0) & (X < 15.0), np.float32(9.0), FLAT))
    seen = visible(RASTER, heights, np.array([10.0, 0.0, 4.0]))
    assert not seen[(X > 20.5) & (np.abs(Y) < 5.0)].any()


def test_unknown_heights_hide_nothing() -> None:
    heights = np.where(X > 10.0, np.float32(np.nan), FLAT)
    assert visible(RASTER, heights, np.array([0.0, 0.0, 30.0])).all()
    assert visible(RASTER, np.full(RASTER.shape, np.nan, np.float32), np.array([0.0, 0.0, 30.0])).all()
