# SPDX-License-Identifier: Apache-2.0
from dataclasses import replace

import numpy as np
import pytest

from uav_vslam.mapping.surface.samples import CellSamples, sample
from uav_vslam.mapping.surface.stereo import PairPoints

CAMERA, DOWN = np.array([5.0, 5.0, 70.0]), np.array([0.0, 0.0, -1.0])


def cloud(height, *, step_m: float = 0.1) -> PairPoints:
    """Return points over 10 x 10 m at the heights of a function of x, y."""
    x, y = (axis.ravel() for axis in np.meshgrid(np.arange(0.05, 10.0, step_m), np.arange(0.05, 10.0, step_m)))
    points = np.column_stack([x, y, height(x, y) + np.zeros_like(x)]).astype(np.float32)
    return PairPoints(points, CAMERA, DOWN, fall_m=70.0, noise_m=0.1, pose_m=0.02, share=1.0)


def heights(samples: CellSamples | None) -> np.ndarray:
    assert samples is not None
    grid = np.full(samples.raster.shape, np.nan)
    grid[samples.rows, samples.columns] = samples.height
    return grid


def test_each_cell_has_the_median_of_its_points() -> None:
    found = sample(cloud(lambda x, y: 0.2 * x), 0.5)
    assert found is not None
    assert heights(found) == pytest.approx(0.2 * found.raster.x + np.zeros((20, 1)), abs=0.02)
    assert (found.count == 25).all()


def test_where_a_wall_crosses_a_cell_the_height_is_of_roof_or_ground_never_between() -> None:
    found = heights(sample(cloud(lambda x, y: np.where(x < 4.75, 0.0, 6.0)), 0.5))
    assert np.minimum(np.abs(found), np.abs(found - 6.0)) == pytest.approx(0.0, abs=0.01)
    assert (found[:, :9] < 1.0).all()
    assert (found[:, 9:] > 5.0).all()  # the roof fills half of column 9


def test_a_roof_that_only_touches_a_cell_does_not_raise_it() -> None:
    found = heights(sample(cloud(lambda x, y: np.where(x < 4.9, 0.0, 6.0)), 0.5))
    assert (found[:, 9] < 1.0).all()


def test_a_lone_pit_is_dropped_and_a_lone_post_is_kept() -> None:
    def uneven(x, y):
        pit = (np.floor(x / 0.5) == 6) & (np.floor(y / 0.5) == 6)
        post = (np.floor(x / 0.5) == 12) & (np.floor(y / 0.5) == 12)
        return np.where(pit, -9.0, np.where(post, 4.0, 0.0))

    found = heights(sample(cloud(uneven), 0.5))
    assert np.isnan(found[6, 6])
    assert found[12, 12] == pytest.approx(4.0, abs=0.01)
    assert np.isnan(found).sum() == 1


def test_cells_with_few_points_stay_unknown() -> None:
    points = cloud(lambda x, y: 0.0 * x)
    kept = (points.points_map[:, 0] < 9.0) | (np.arange(len(points.points_map)) % 7 == 0)
    thin = PairPoints(points.points_map[kept], CAMERA, DOWN, 70.0, 0.1, 0.02, 1.0)
    assert np.isnan(heights(sample(thin, 0.5))[:, 18:]).all()
    assert np.isfinite(heights(sample(thin, 0.5))[:, :18]).all()


def test_sigma_holds_the_shared_part_and_grows_with_the_spread() -> None:
    flat, rough = sample(cloud(lambda x, y: 0.0 * x), 0.5), sample(cloud(lambda x, y: 0.5 * np.sin(40.0 * x * y)), 0.5)
    assert flat is not None
    assert rough is not None
    assert flat.sigma == pytest.approx(np.hypot(0.02, 0.1 / np.sqrt(2.0)), rel=1e-5)
    assert np.median(rough.sigma) > 2.0 * np.median(flat.sigma)


def test_sigma_grows_with_depth_and_fall() -> None:
    points = cloud(lambda x, y: 0.0 * x)
    oblique = np.array([0.0, -0.6, -0.8])
    far = sample(replace(points, camera_map=np.array([5.0, 75.0, 70.0]), depth_map=oblique), 0.5)
    assert far is not None
    away = 75.0 - far.raster.y[far.rows]
    assert far.sigma == pytest.approx(np.hypot(0.02, 0.1 / np.sqrt(2.0)) * (0.6 * away + 56.0) / 70.0, rel=1e-5)


def test_the_view_angle_is_that_from_the_vertical() -> None:
    found = sample(cloud(lambda x, y: 0.0 * x), 0.5)
    assert found is not None
    corner = (found.rows == 0) & (found.columns == 0)
    assert found.angle[corner] == pytest.approx(np.arctan(np.hypot(4.75, 4.75) / 70.0), rel=1e-5)


def test_no_points_give_no_samples() -> None:
    assert sample(PairPoints(np.zeros((0, 3), np.float32), CAMERA, DOWN, 70.0, 0.1, 0.02, 0.0), 0.5) is None
