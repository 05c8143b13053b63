# SPDX-License-Identifier: Apache-2.0
"""Tracks that are tied to their first image do not slide, over a texture whose true motion is known."""

import itertools
from collections.abc import Callable

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from uav_vslam.vision.tracking.anchors import MOST_PX, Anchors
from uav_vslam.vision.tracking.flow import FlowImage, track_turning
from uav_vslam.vision.tracking.tracks import Tracks

Array = NDArray[np.float64]

CENTRE = np.array([250.0, 200.0])
TURN_DEG, NOISE = 1.5, 4.0  # a frame, and of the images [grey values]
FRAMES = 12


def motion(frame: int) -> Array:
    return cv2.getRotationMatrix2D(tuple(CENTRE), TURN_DEG * frame, 1.0)


def moved(pixels: Array, frames: int) -> Array:
    M = motion(frames)
    return np.asarray(pixels @ M[:, :2].T + M[:, 2])


def some_points() -> Array:
    return np.random.default_rng(4).uniform(CENTRE - 90.0, CENTRE + 90.0, (100, 2))


@pytest.fixture(scope="module")
def images(texture_image: Callable[[int, int], NDArray[np.uint8]]) -> list[FlowImage]:
    """A noisy texture that turns from image to image."""
    texture, rng = texture_image(400, 500), np.random.default_rng(3)
    turned = (
        cv2.warpAffine(texture, motion(k), (500, 400), flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT_101)
        for k in range(FRAMES)
    )
    return [
        FlowImage.of(np.clip(image + rng.normal(0, NOISE, image.shape), 0, 255).astype(np.uint8)) for image in turned
    ]


def started(pixels: Array) -> Tracks:
    return Tracks.none().with_new(pixels, np.zeros((len(pixels), 128), np.uint8), 1)


def slides_px(images: list[FlowImage], anchors: Anchors | None) -> Array:
    """Return how far each point that is tracked to the end has slid [px]."""
    start = some_points()
    tracks = started(start)
    for before, image in itertools.pairwise(images):
        if anchors is not None:
            anchors.start(tracks, before)
        pixels, good = track_turning(before, image, tracks.pixels, tracks.pixels)
        tracks = Tracks(tracks.ids, pixels, tracks.depth_m, tracks.descriptors).chosen(good)
        if anchors is not None:
            tracks = anchors.refined(tracks, image)
    return np.linalg.norm(tracks.pixels - moved(start[tracks.ids - 1], FRAMES - 1), axis=1)


def test_errors_do_not_add_up(images: list[FlowImage]) -> None:
    alone, anchored = slides_px(images, None), slides_px(images, Anchors())
    assert len(anchored) >= 0.95 * len(alone)
    assert np.median(anchored) < 0.4 * np.median(alone)


def test_the_disparity_is_more_exact_with_both_images_tied(images: list[FlowImage]) -> None:
    anchors, start = Anchors(), some_points()
    anchors.start(started(start), images[0])
    left = anchors.refined(started(moved(start, 1)), images[1])
    flow, _ = track_turning(images[1], images[2], left.pixels, left.pixels)
    by_flow, tied = (
        np.median(np.linalg.norm(right - moved(left.pixels, 1), axis=1))
        for right in (flow, anchors.across(left, flow, images[2]))
    )
    assert tied < 0.8 * by_flow


def test_a_point_farther_off_than_a_correction_starts_anew(images: list[FlowImage]) -> None:
    anchors, start = Anchors(), CENTRE + np.array([[0.0, 0.0], [40.0, 10.0]])
    anchors.start(started(start), images[0])
    wrong = start + np.array([[3.0 * MOST_PX, 0.0], [0.3, 0.0]])
    tracks = anchors.refined(started(wrong), images[0])
    np.testing.assert_allclose(tracks.pixels, [wrong[0], start[1]], atol=0.02)
    anchors.start(tracks, images[0])
    tracks = anchors.refined(started(wrong + np.array([0.3, 0.0])), images[0])
    np.testing.assert_allclose(tracks.pixels, [wrong[0], start[1]], atol=0.02)


def test_a_point_at_the_border_has_no_anchor_and_goes_on(images: list[FlowImage]) -> None:
    anchors, start = Anchors(), np.array([[9.0, 200.0]])
    anchors.start(started(start), images[0])
    now = start + 0.4
    np.testing.assert_array_equal(anchors.refined(started(now), images[0]).pixels, now)


def test_without_tracks_there_are_no_anchors(images: list[FlowImage]) -> None:
    anchors, start = Anchors(), CENTRE[None]
    anchors.start(started(start), images[0])
    assert len(anchors.refined(Tracks.none(), images[0])) == 0
    now = start + 0.3
    np.testing.assert_array_equal(anchors.refined(started(now), images[0]).pixels, now)


def test_a_point_that_was_hidden_gets_a_new_anchor(images: list[FlowImage]) -> None:
    anchors, start = Anchors(), CENTRE[None]
    anchors.start(started(start), images[0])
    hidden = FlowImage.of(np.full_like(images[0].grey, 128))
    now = start + 0.3
    tracks = anchors.refined(started(now), hidden)
    np.testing.assert_array_equal(tracks.pixels, now)
    anchors.start(tracks, images[0])
    np.testing.assert_allclose(anchors.refined(started(start), images[0]).pixels, now, atol=0.02)
