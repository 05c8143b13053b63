# SPDX-License-Identifier: Apache-2.0
"""Optical flow between two views of one texture, whose true motion is known."""

from collections.abc import Callable

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from uav_vslam.vision.tracking.flow import Flow, FlowImage, shift_between, track_coarsely, track_points

Array = NDArray[np.float64]
Pair = tuple[FlowImage, FlowImage]

SHIFT_PX = np.array([7.3, -4.6])
PRECISION_PX = 0.05  # rms, of resampling; without noise
STOP_PX = 0.03  # between two runs of an iteration that stops at steps of 0.01 px
COARSE_PRECISION_PX = 0.5


def shifted(image: NDArray[np.uint8], shift: Array) -> NDArray[np.uint8]:
    motion = np.hstack([np.eye(2), shift[:, None]])
    return np.asarray(cv2.warpAffine(image, motion, image.shape[::-1], flags=cv2.INTER_CUBIC), np.uint8)


@pytest.fixture(scope="module")
def pair(texture_image: Callable[[int, int], NDArray[np.uint8]]) -> Pair:
    image = texture_image(400, 500)
    return FlowImage(image), FlowImage(shifted(image, SHIFT_PX))


@pytest.fixture
def pixels() -> Array:
    """Points whose surroundings both views show."""
    return np.random.default_rng(1).uniform([60, 60], [440, 340], (80, 2))


@pytest.mark.parametrize("error_px", [0.0, 0.7, 5.0, 25.0])
def test_the_precision_does_not_depend_on_the_guess(pair: Pair, pixels: Array, error_px: float) -> None:
    there, tracked = track_points(*pair, pixels, pixels + SHIFT_PX + error_px)
    assert tracked.mean() > 0.95
    assert np.sqrt(np.mean((there[tracked] - pixels[tracked] - SHIFT_PX) ** 2)) < PRECISION_PX
    exact, _ = track_points(*pair, pixels, pixels + SHIFT_PX)
    assert np.abs(there - exact)[tracked].max() < STOP_PX


def test_coarse_tracking_is_right_within_half_a_pixel(pair: Pair, pixels: Array) -> None:
    there, seen = track_coarsely(*pair, pixels, pixels + SHIFT_PX + 25.0)
    assert seen.mean() > 0.95
    assert np.percentile(np.abs(there - pixels - SHIFT_PX), 95) < COARSE_PRECISION_PX


@pytest.mark.parametrize(("degrees", "scale"), [(6.0, 1.0), (-12.0, 1.05), (0.0, 1.1)])
def test_ground_that_turns_or_comes_nearer_does_not_slide(texture_image, pixels, degrees, scale) -> None:
    image = texture_image(400, 500)
    motion = cv2.getRotationMatrix2D((250.0, 200.0), degrees, scale)
    second = FlowImage(
        cv2.warpAffine(image, motion, (500, 400), flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT_101)
    )
    pixels = pixels[np.linalg.norm(pixels - [250.0, 200.0], axis=1) < 140.0]  # seen in both
    true = pixels @ motion[:, :2].T + motion[:, 2]
    there, tracked = Flow(FlowImage(image), second, pixels, true + 0.5).tracked()
    assert tracked.mean() > 0.95
    turned_px = np.sqrt(np.mean((there - true)[tracked] ** 2))
    there, tracked = track_points(FlowImage(image), second, pixels, true + 0.5)
    assert turned_px < PRECISION_PX
    assert turned_px < 0.5 * np.sqrt(np.mean((there - true)[tracked] ** 2))


def test_a_few_points_do_not_tell_of_a_turn(pair: Pair, pixels: Array) -> None:
    guess = pixels[:2] + SHIFT_PX + np.array([[0.0, 3.0], [0.0, -3.0]])
    np.testing.assert_array_equal(
        Flow(*pair, pixels[:2], guess).tracked()[0], track_points(*pair, pixels[:2], guess)[0]
    )
    there, tracked = Flow(*pair, pixels[:1], pixels[:1] + SHIFT_PX).tracked()
    assert tracked.all()
    np.testing.assert_allclose(there, pixels[:1] + SHIFT_PX, atol=3.0 * PRECISION_PX)


def test_points_that_left_the_image_are_not_tracked(pair: Pair) -> None:
    pixels = np.array([[488.0, 200.0], [250.0, 200.0], [250.0, 10.0]])
    _, tracked = track_points(*pair, pixels, pixels + SHIFT_PX)
    np.testing.assert_array_equal(tracked, [False, True, False])


def test_points_without_a_counterpart_are_not_tracked(pair: Pair, pixels: Array) -> None:
    rng, shares = np.random.default_rng(2), []
    for _ in range(10):
        noise = FlowImage(rng.integers(0, 256, pair[0].shape, np.uint8))
        shares.append(track_points(pair[0], noise, pixels, pixels)[1].mean())
    assert np.mean(shares) < 0.1  # that come back by chance


def test_no_points_are_tracked_to_none(pair: Pair) -> None:
    there, tracked = Flow(*pair, np.zeros((0, 2)), np.zeros((0, 2))).tracked()
    assert there.shape == (0, 2)
    assert tracked.shape == (0,)


@pytest.mark.parametrize("shape", [(12, 12), (40, 61)])
def test_images_hardly_larger_than_the_window_do_not_fail(shape: tuple[int, int]) -> None:
    image = FlowImage(np.random.default_rng(3).integers(0, 256, shape, np.uint8))
    centre = np.array([[shape[1] / 2, shape[0] / 2]])
    there, tracked = track_points(image, image, centre, centre + 3.0)
    assert there.shape == (1, 2)
    assert tracked.shape == (1,)


def test_the_global_shift_is_found(texture_image: Callable[[int, int], NDArray[np.uint8]]) -> None:
    texture, shift = texture_image(480, 512), np.array([64, 40])
    views = [FlowImage(np.ascontiguousarray(texture[v : v + 400, u : u + 420])) for u, v in ([0, 0], shift)]
    np.testing.assert_allclose(shift_between(*views), -shift, atol=8.0)
