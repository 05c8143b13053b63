# SPDX-License-Identifier: Apache-2.0
"""Faults detected from one camera's images."""

from collections.abc import Callable

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from uav_vslam.vision.image_watch import USUAL_FRAMES, ImageWatch, contrast

Grey = NDArray[np.uint8]


@pytest.fixture
def images(texture_image: Callable[[int, int], Grey]) -> list[Grey]:
    """Views of one texture, each shifted by a few pixels."""
    texture = texture_image(300, 400)
    return [np.ascontiguousarray(texture[:240, 5 * k : 5 * k + 320]) for k in range(10)]


def test_a_camera_moving_over_texture_has_no_fault(images: list[Grey]) -> None:
    watch = ImageWatch()
    assert [watch.add(image) for image in images] == [[]] * 10
    assert not watch.blind


def test_a_repeated_image_is_frozen(images: list[Grey]) -> None:
    watch = ImageWatch()
    watch.add(images[0])
    (text,) = watch.add(images[0].copy())
    assert "frozen" in text
    assert watch.blind
    assert watch.add(images[1]) == []
    assert not watch.blind


def test_contrast_leaves_out_the_darkest_and_brightest_two_percent() -> None:
    image = np.random.default_rng(1).permutation(np.repeat(np.arange(100, dtype=np.uint8), 50)).reshape(50, 100)
    assert contrast(image) == pytest.approx(np.subtract(*np.percentile(image, (98, 2))), abs=1.0)


@pytest.mark.parametrize("grey", [0, 200, 255])
def test_an_image_without_contrast_is_reported_every_time(images: list[Grey], grey: int) -> None:
    watch = ImageWatch()
    watch.add(images[0])
    for _ in range(2):
        (text,) = watch.add(np.full((240, 320), grey, np.uint8))
        assert "shows nothing" in text
        assert watch.blind
    assert watch.add(images[1]) == []  # and its brightness has not jumped


@pytest.mark.parametrize("factor", [0.6, 1.6])
def test_a_jump_in_brightness_is_reported_once_and_the_image_used(images: list[Grey], factor: float) -> None:
    watch = ImageWatch()
    watch.add(images[0])
    changed = [np.clip(factor * image, 0, 255).astype(np.uint8) for image in images[1:3]]
    (text,) = watch.add(changed[0])
    assert "jumped in brightness" in text
    assert not watch.blind
    assert watch.add(changed[1]) == []


def test_smoother_ground_becomes_the_baseline(images: list[Grey]) -> None:
    watch = ImageWatch()
    for k in range(30):
        watch.add(images[k % 10])
    smooth = [cv2.blur(image, (9, 9)) for image in images]
    reported = [watch.add(smooth[k % 10]) != [] for k in range(2 * USUAL_FRAMES)]
    assert all(reported[: USUAL_FRAMES - 1])
    assert not any(reported[USUAL_FRAMES:])


def test_a_field_of_another_brightness_is_not_taken_for_blur(images: list[Grey]) -> None:
    watch = ImageWatch()
    for image in images[:6]:
        watch.add(image)
    field = np.clip(images[6] / 2.0 + 110.0 * (np.arange(320) >= 250), 0, 255).astype(np.uint8)
    assert not any("blurred" in text for text in watch.add(field))


@pytest.mark.parametrize("angle_deg", [0.0, 45.0, 90.0, 150.0])
def test_motion_blur_in_any_direction_is_distinguished_from_smooth_ground(images: list[Grey], angle_deg: float) -> None:
    """Motion blur of seven pixels; isotropically smoother ground is not blurred."""
    watch, line = ImageWatch(), np.zeros((9, 9), np.float32)
    reach = 3.0 * np.array([np.cos(np.deg2rad(angle_deg)), np.sin(np.deg2rad(angle_deg))])
    for share in np.linspace(-1.0, 1.0, 41):
        u, v = np.rint(4.0 + share * reach).astype(int)
        line[v, u] = 1.0
    for image in images[:6]:
        assert watch.add(image) == []
    assert watch.add(cv2.GaussianBlur(images[6], (0, 0), 1.0)) == []
    (text,) = watch.add(cv2.filter2D(images[7], -1, line / line.sum()))
    assert "by motion" in text


def test_motion_blur_is_reported_as_long_as_it_lasts(images: list[Grey]) -> None:
    watch = ImageWatch()
    for image in images[:6]:
        watch.add(image)
    for image, blurred in zip(images[6:9], ((21, 5), (9, 9), (7, 1)), strict=True):
        (text,) = watch.add(cv2.blur(image, blurred))
        assert "blurred" in text
        assert not watch.blind
    assert watch.add(images[9]) == []
