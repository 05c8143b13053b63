# SPDX-License-Identifier: Apache-2.0
"""The lens's derivatives are those of its projection, its inverse undoes it, and it is the camera of `geometry`."""

import numpy as np

from uav_vslam.mapping.pictures.lens import PARAMETERS, bearings, camera_of, project, project_jacobians

RNG = np.random.default_rng(2)
POINTS = RNG.uniform([-0.6, -0.6, 0.8], [0.6, 0.6, 1.6], (20, 3))
LENS = np.tile([np.log(900.0), -0.08, 0.03, 0.01, -0.005], (20, 1))
STEP = 1e-6
SIZE = (1600, 1200)


def test_the_jacobians_are_the_numerical_ones() -> None:
    by_point, by_lens = project_jacobians(POINTS, LENS)
    for k, step in enumerate(STEP * np.eye(3)):
        along_point = (project(POINTS + step, LENS) - project(POINTS - step, LENS)) / (2.0 * STEP)
        np.testing.assert_allclose(by_point[:, :, k], along_point, rtol=1e-6, atol=1e-4)
    for k, step in enumerate(STEP * np.eye(PARAMETERS)):
        along_lens = (project(POINTS, LENS + step) - project(POINTS, LENS - step)) / (2.0 * STEP)
        np.testing.assert_allclose(by_lens[:, :, k], along_lens, rtol=1e-6, atol=1e-4)


def test_bearings_undo_the_projection() -> None:
    found = bearings(project(POINTS, LENS), LENS)
    np.testing.assert_allclose(found, POINTS[:, :2] / POINTS[:, 2:], atol=1e-6)


def test_the_camera_images_points_where_the_lens_does() -> None:
    camera = camera_of(LENS[0], *SIZE)
    pixels = camera.distort(camera.project(POINTS)) - 0.5 * (np.array(SIZE) - 1.0)
    np.testing.assert_allclose(pixels, project(POINTS, LENS), atol=1e-9)
