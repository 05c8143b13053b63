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
    start = np.random.default_rng(4).uniform(CENTRE - 90.0, CENTRE + 90.0, (100, 2))
    tracks = started(start)
    for before, image in itertools.pairwise(images):
        if anchors is not None:
            anchors.start(tracks, before)
        pixels, good = track_turning(before, image, tracks.pixels, tracks.pixels)
        tracks = Tracks(tracks.ids, pixels, tracks.depth_m, tracks.descriptors).chosen(good)
        if anchors is not None:
            tracks = anchors.refined(tracks, image)
    M = motion(FRAMES - 1)
    true = start[tracks.ids - 1] @ M[:, :2].T + M[:, 2]
    return np.linalg.norm(tracks.pixels - true, axis=1)


def test_errors_do_not_add_up(images: list[FlowImage]) -> None:
    alone, anchored = slides_px(images, None), slides_px(images, Anchors())
    assert len(anchored) >= 0.95 * len(alone)
    assert np.median(anchored) < 0.4 * np.median(alone)


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
    moved = start + 0.4
    np.testing.assert_array_equal(anchors.refined(started(moved), images[0]).pixels, moved)


def test_without_tracks_there_are_no_anchors(images: list[FlowImage]) -> None:
    anchors, start = Anchors(), CENTRE[None]
    anchors.start(started(start), images[0])
    assert len(anchors.refined(Tracks.none(), images[0])) == 0
    moved = start + 0.3
    np.testing.assert_array_equal(anchors.refined(started(moved), images[0]).pixels, moved)


def test_a_point_that_was_hidden_gets_a_new_anchor(images: list[FlowImage]) -> None:
    anchors, start = Anchors(), CENTRE[None]
    anchors.start(started(start), images[0])
    hidden = FlowImage.of(np.full_like(images[0].grey, 128))
    moved = start + 0.3
    tracks = anchors.refined(started(moved), hidden)
    np.testing.assert_array_equal(tracks.pixels, moved)
    anchors.start(tracks, images[0])
    np.testing.assert_allclose(anchors.refined(started(start), images[0]).pixels, moved, atol=0.02)
