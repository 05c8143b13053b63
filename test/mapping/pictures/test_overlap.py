# SPDX-License-Identifier: Apache-2.0
"""A place of the ground is counted where the lens images it, and nowhere else."""

import itertools
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from uav_vslam.geometry.pose import Pose
from uav_vslam.mapping.pictures.lens import camera_of, fold_radius
from uav_vslam.mapping.pictures.overlap import view_counts
from uav_vslam.mapping.raster import Raster

WIDTH, HEIGHT, FOCAL_PX, UP_M = 1600, 1200, 1360.0, 80.0
CELL_M = 0.5
RASTER = Raster(CELL_M, -400, -400, 800, 800)
LEVEL: Any = SimpleNamespace(raster=RASTER, grid=np.zeros(RASTER.shape))
DOWN = Pose(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, UP_M]))


def border() -> np.ndarray:
    """Return (N, 2) pixels around the image, in order."""
    right, bottom = WIDTH - 1.0, HEIGHT - 1.0
    corners = np.array([[0.0, 0.0], [right, 0.0], [right, bottom], [0.0, bottom], [0.0, 0.0]])
    return np.concatenate([np.linspace(a, b, 100, endpoint=False) for a, b in itertools.pairwise(corners)])


@pytest.mark.parametrize(("k1", "k2"), [(-0.2, 0.0), (-0.1, 0.0), (0.0, 0.0), (0.1, 0.0), (-0.3, 0.1)])
def test_the_ground_that_a_lens_shows_is_counted(k1: float, k2: float) -> None:
    camera = camera_of(np.array([np.log(FOCAL_PX), k1, k2, 0.0, 0.0]), WIDTH, HEIGHT)
    counts = view_counts(LEVEL, [(camera, DOWN)])
    x, y = UP_M * camera.bearings(camera.undistort(border()))[:, :2].T
    outlined_m2 = 0.5 * abs(float(x @ np.roll(y, -1) - y @ np.roll(x, -1)))
    assert counts.sum() * CELL_M**2 == pytest.approx(outlined_m2, rel=0.01)  # of the outline's cells, one in two
    assert counts.max() == 1


def test_a_model_that_folds_back_shows_nothing_from_beyond_its_fold() -> None:
    assert fold_radius(-0.2, 0.0) == pytest.approx(np.sqrt(1.0 / 0.6))
    assert fold_radius(0.1, 0.0) == fold_radius(0.0, 0.0) == np.inf
    camera = camera_of(np.array([np.log(FOCAL_PX), -0.2, 0.0, 0.0, 0.0]), WIDTH, HEIGHT)
    x, y = np.meshgrid(RASTER.x, RASTER.y)
    beyond = np.hypot(x, y) > UP_M * fold_radius(-0.2, 0.0)
    assert beyond.any()
    assert not view_counts(LEVEL, [(camera, DOWN)])[beyond].any()


def test_what_is_behind_a_camera_is_not_counted() -> None:
    camera = camera_of(np.array([np.log(FOCAL_PX), -0.1, 0.0, 0.0, 0.0]), WIDTH, HEIGHT)
    assert not view_counts(LEVEL, [(camera, Pose(np.eye(3), DOWN.t))]).any()
