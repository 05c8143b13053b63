# SPDX-License-Identifier: Apache-2.0
"""Observation Jacobians in every model's coordinates; depth smoothing; the visibility check."""

import numpy as np
import pytest
from numpy.typing import NDArray

from uav_vslam.estimation.models import MODELS
from uav_vslam.estimation.observation import (
    MIN_DEPTH_M,
    point_jacobian,
    projectable,
    smoothed,
    triangulation_covariance,
)

Array = NDArray[np.float64]

STEP = 1e-6  # of each coordinate, central differences
DIFFERENCE = 2e-5  # relative to 1600 px a radian: rounding of pixels of order 1000 over the step is 1e-7 px


@pytest.mark.parametrize("name", sorted(MODELS))
def test_observation_jacobian_is_the_numerical_one_in_each_models_coordinates(course, name: str) -> None:
    f = course.flown(name)
    rows = np.array([4, 0, 7])
    predicted = f.predict_observations(rows)
    model, m = MODELS[name](), len(f.covariance()) - 3 * len(f.landmarks)
    numeric = np.zeros((3, 4, len(f.covariance())))
    for k in range(len(f.covariance())):
        step = np.zeros(len(f.covariance()))
        step[k] = STEP
        z = []
        for sign in (1.0, -1.0):
            nav, landmarks = model.retract(f.nav, f.landmarks, sign * step)
            z.append(course.rig.project(point_jacobian(course.rig, nav, landmarks[rows]).points_left))
        numeric[:, :, k] = (z[0] - z[1]) / (2 * STEP)
    scale = np.abs(numeric).max()
    np.testing.assert_allclose(predicted.H_vehicle / scale, numeric[:, :, :m] / scale, rtol=0, atol=DIFFERENCE)
    for n, row in enumerate(rows):
        own = numeric[n, :, m + 3 * row : m + 3 * row + 3]
        np.testing.assert_allclose(predicted.H_landmark[n] / scale, own / scale, rtol=0, atol=DIFFERENCE)
        others = np.delete(numeric[n, :, m:], np.arange(3 * row, 3 * row + 3), axis=1)
        np.testing.assert_array_equal(others, 0.0)


@pytest.mark.parametrize("name", sorted(MODELS))
def test_innovation_covariance_is_that_of_the_dense_jacobian(course, name: str) -> None:
    f = course.flown(name)
    rows = np.array([2, 9])
    predicted = f.predict_observations(rows)
    m = len(f.covariance()) - 3 * len(f.landmarks)
    for n, row in enumerate(rows):
        H = np.zeros((4, len(f.covariance())))
        H[:, :m] = predicted.H_vehicle[n]
        H[:, m + 3 * row : m + 3 * row + 3] = predicted.H_landmark[n]
        np.testing.assert_allclose(
            predicted.innovation_covariance()[n], H @ f.covariance() @ H.T + np.eye(4), rtol=1e-9, atol=1e-9
        )


def test_smoothing_moves_uncertain_depths_to_the_ground_and_keeps_certain_ones() -> None:
    points = np.array([[1.0, 2.0, 60.0], [1.0, 2.0, 70.0], [1.0, 2.0, 80.0]])
    sure = smoothed(points, np.zeros(3), depth_sigma_ratio=0.05)
    np.testing.assert_allclose(sure, points, rtol=1e-12)
    uncertain = smoothed(points, np.full(3, 1e9), depth_sigma_ratio=0.05)
    np.testing.assert_allclose(uncertain[:, 2], 70.0, rtol=1e-6)
    np.testing.assert_allclose(uncertain[:, :2] / uncertain[:, 2:], points[:, :2] / points[:, 2:], rtol=1e-12)
    even = smoothed(points, np.full(3, (0.05 * 70.0) ** 2), depth_sigma_ratio=0.05)  # as uncertain as the relief
    np.testing.assert_allclose(even[:, 2], [65.0, 70.0, 75.0], rtol=1e-12)


@pytest.mark.parametrize(
    "points", [np.zeros((0, 3)), np.array([[0.0, 0.0, -5.0]]), np.array([[0.0, 0.0, MIN_DEPTH_M]])]
)
def test_smoothing_keeps_points_that_are_not_in_front(points: Array) -> None:
    np.testing.assert_array_equal(smoothed(points, np.ones(len(points)), depth_sigma_ratio=0.05), points)


def test_zero_ratio_disables_smoothing() -> None:
    points = np.array([[1.0, 2.0, 60.0], [1.0, 2.0, 90.0]])
    np.testing.assert_array_equal(smoothed(points, np.full(2, 1e9), depth_sigma_ratio=0.0), points)


def test_a_point_must_be_in_front_of_both_cameras_and_inside_both_images(course) -> None:
    rig = course.rig
    centre, front_edge = rig.left.bearings([640.0, 480.0]), rig.left.bearings([640.0, 5.0])
    points = np.vstack(
        [70.0 * centre, -70.0 * centre, 0.5 * MIN_DEPTH_M * centre, 70.0 * rig.left.bearings([-5.0, 480.0])]
    )
    assert projectable(rig, points).tolist() == [True, False, False, False]
    assert projectable(rig, points, margin_px=6.0).tolist() == [True, False, False, True]
    # The right camera is behind the left one: close points at the left one's front edge are outside its image.
    assert projectable(rig, np.vstack([5.0 * front_edge, 5.0 * centre])).tolist() == [False, True]
    assert projectable(rig, np.zeros((0, 3))).shape == (0,)


def test_triangulation_covariance_is_that_of_noisy_pixels(course) -> None:
    """Linear prediction against 4000 draws: tolerance 3 / sqrt(4000), plus the depth's skewness."""
    rig = course.rig
    point = rig.left.bearings([[300.0, 600.0]]) * 20.0
    pixels = rig.project(point) + np.random.default_rng(0).normal(0, 0.5, (4000, 4))
    spread = np.cov(rig.triangulate(pixels).T)
    expected = triangulation_covariance(rig, point, 0.5)[0]
    L = np.linalg.cholesky(expected)
    whitened = np.linalg.solve(L, np.linalg.solve(L, spread).T)
    np.testing.assert_allclose(whitened, np.eye(3), rtol=0, atol=0.08)
