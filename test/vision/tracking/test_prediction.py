# SPDX-License-Identifier: Apache-2.0
"""Predicted pixels of tracked points, beside their true motion."""

from collections.abc import Callable

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from uav_vslam.geometry.rotation import so3_exp
from uav_vslam.vision.tracking.flow import FlowImage
from uav_vslam.vision.tracking.prediction import FlowModel, by_homography

Array = NDArray[np.float64]
Grey = NDArray[np.uint8]

K = np.array([[600.0, 0.0, 250.0], [0.0, 600.0, 200.0], [0.0, 0.0, 1.0]])


@pytest.fixture
def image(texture_image: Callable[[int, int], Grey]) -> Grey:
    return texture_image(400, 500)


@pytest.fixture
def pixels() -> Array:
    return np.random.default_rng(1).uniform([70, 70], [430, 330], (100, 2))


def turned(image: Grey, pixels: Array, angles_deg: tuple[float, float, float]) -> tuple[Grey, Array]:
    """Return the view after a rotation of the camera, and the pixels there."""
    H = K @ so3_exp(np.deg2rad(angles_deg)) @ np.linalg.inv(K)
    view = np.asarray(cv2.warpPerspective(image, H, image.shape[::-1], flags=cv2.INTER_CUBIC), np.uint8)
    return view, cv2.perspectiveTransform(pixels[None], H)[0]


def test_any_change_of_rotation_is_predicted_within_a_pixel(image: Grey, pixels: Array) -> None:
    view, there = turned(image, pixels, (2.0, -1.5, 4.0))
    assert np.linalg.norm(there - pixels, axis=1).max() > 30.0
    predicted = by_homography(FlowImage(image), FlowImage(view), pixels, pixels)
    assert predicted is not None
    assert np.linalg.norm(predicted - there, axis=1).max() < 1.0


def test_wrong_points_in_the_sample_do_not_mislead_the_others(image: Grey, pixels: Array) -> None:
    view, there = turned(image, pixels, (1.0, 0.5, 1.0))
    view[:, 350:] = np.random.default_rng(2).integers(0, 256, (400, 150), np.uint8)
    predicted = by_homography(FlowImage(image), FlowImage(view), pixels, pixels)
    assert predicted is not None
    shown = there[:, 0] < 350
    assert np.linalg.norm(predicted - there, axis=1)[shown].max() < 2.0


def test_unrelated_images_and_few_points_give_no_prediction(image: Grey, pixels: Array) -> None:
    first, noise = FlowImage(image), FlowImage(np.random.default_rng(3).integers(0, 256, (400, 500), np.uint8))
    assert by_homography(first, noise, pixels, pixels) is None
    assert by_homography(first, first, pixels[:5], pixels[:5]) is None
    assert by_homography(first, first, np.zeros((0, 2)), np.zeros((0, 2))) is None


def test_an_affine_flow_goes_on_in_spite_of_a_few_wrong_points(pixels: Array) -> None:
    def moved(places: Array, dt_s: float) -> Array:
        return places + dt_s * (places @ [[0.1, -0.2], [0.05, 0.0]] + [20.0, -30.0])

    after = moved(pixels, 0.1)
    after[:10] += 50.0
    flow = FlowModel()
    flow.fit(pixels, after, 0.1)
    np.testing.assert_allclose(flow.predict(pixels, 0.2), moved(pixels, 0.2), atol=1e-6)
    flow.fit(pixels[:3], after[:3], 0.1)
    np.testing.assert_array_equal(flow.predict(pixels, 0.2), pixels)
