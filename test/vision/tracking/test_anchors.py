# SPDX-License-Identifier: Apache-2.0
"""Tracks that are tied to their first image do not slide, over a texture whose true motion is known."""

import dataclasses
import itertools
from collections.abc import Callable

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from uav_vslam.vision.tracking.anchors import MOST_PX, Anchors
from uav_vslam.vision.tracking.flow import Flow, FlowImage
from uav_vslam.vision.tracking.tracks import Tracks

Array = NDArray[np.float64]

CENTRE = np.array([250.0, 200.0])
TURN_DEG, NOISE = 1.5, 4.0  # a frame, and of the images [grey values]
FRAMES = 12
FAINT = 0.3  # contrast


def motion(frame: int) -> Array:
    return cv2.getRotationMatrix2D(tuple(CENTRE), TURN_DEG * frame, 1.0)


def moved(pixels: Array, frames: int) -> Array:
    M = motion(frames)
    return np.asarray(pixels @ M[:, :2].T + M[:, 2])


def some_points() -> Array:
    return np.random.default_rng(4).uniform(CENTRE - 90.0, CENTRE + 90.0, (100, 2))


def turning(texture: NDArray[np.floating]) -> list[FlowImage]:
    """Return noisy images of a texture that turns from one to the next."""
    rng = np.random.default_rng(3)
    turned = (
        cv2.warpAffine(texture, motion(k), (500, 400), flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT_101)
        for k in range(FRAMES)
    )
    return [FlowImage(np.clip(image + rng.normal(0, NOISE, image.shape), 0, 255).astype(np.uint8)) for image in turned]


@pytest.fixture(scope="module")
def images(texture_image: Callable[[int, int], NDArray[np.uint8]]) -> list[FlowImage]:
    return turning(texture_image(400, 500))


def started(pixels: Array) -> Tracks:
    return Tracks.none().with_new(pixels, np.zeros((len(pixels), 128), np.uint8), 1)


def slides_px(images: list[FlowImage], anchors: Anchors | None) -> Array:
    """Return how far each point that is tracked to the end has slid [px]."""
    start = some_points()
    tracks = started(start)
    for before, image in itertools.pairwise(images):
        if anchors is not None:
            anchors.start(tracks, before)
        flow = Flow(before, image, tracks.pixels, tracks.pixels)
        pixels, good = flow.tracked() if anchors is None else anchors.into_left(tracks.ids, flow)
        tracks = Tracks(tracks.ids, pixels, tracks.depth_m, tracks.descriptors).chosen(good)
    return np.linalg.norm(tracks.pixels - moved(start[tracks.ids - 1], FRAMES - 1), axis=1)


def test_errors_do_not_add_up(images: list[FlowImage]) -> None:
    alone, anchored = slides_px(images, None), slides_px(images, Anchors())
    assert len(anchored) >= 0.95 * len(alone)
    assert np.median(anchored) < 0.4 * np.median(alone)


def test_noise_of_faint_images_does_not_add_up(texture_image: Callable[[int, int], NDArray[np.uint8]]) -> None:
    texture = texture_image(400, 500)
    images = turning(texture.mean() + FAINT * (texture - texture.mean()))
    alone, anchored = slides_px(images, None), slides_px(images, Anchors())
    assert len(anchored) >= 0.9 * len(alone)
    assert np.median(anchored) < 0.5 * np.median(alone)


def test_the_disparity_is_more_exact_with_both_images_tied(images: list[FlowImage]) -> None:
    anchors, start = Anchors(), some_points()
    tracks = started(start)
    anchors.start(tracks, images[0])
    left, _ = anchors.into_left(tracks.ids, Flow(*images[:2], start, moved(start, 1)))
    across = Flow(*images[1:3], left, left)
    by_flow, tied = (
        np.median(np.linalg.norm(right - moved(left, 1), axis=1))
        for right, _ in (across.tracked(), anchors.into_right(tracks.ids, across))
    )
    assert tied < 0.8 * by_flow


def test_a_bad_guess_costs_no_precision(images: list[FlowImage]) -> None:
    start, found = some_points(), []
    tracks = started(start)
    for error_px in (0.0, 4.0 * MOST_PX):
        anchors = Anchors()
        anchors.start(tracks, images[0])
        pixels, seen = anchors.into_left(tracks.ids, Flow(*images[:2], start, moved(start, 1) + error_px))
        assert seen.all()
        found.append(pixels)
    assert np.percentile(np.abs(found[0] - found[1]), 95) < 0.05


def test_on_faint_images_places_do_not_lean_towards_their_guesses(texture_image) -> None:
    rng, start = np.random.default_rng(5), some_points()
    faint = 128.0 + FAINT * (texture_image(400, 500) - 128.0)
    first, second = (FlowImage(np.rint(faint + rng.normal(0, NOISE, faint.shape)).astype(np.uint8)) for _ in range(2))
    found = []
    for error_px in (-0.4, 0.4):
        anchors = Anchors()
        anchors.start(started(start), first)
        pixels, seen = anchors.into_left(started(start).ids, Flow(first, second, start, start + error_px))
        assert seen.mean() > 0.9
        found.append(np.where(seen[:, None], pixels, np.nan))
    assert np.abs(np.nanmean(found[1] - found[0], axis=0)).max() < 0.08  # a tenth of the guesses' difference


def test_other_ground_is_not_taken_for_the_anchor(images: list[FlowImage]) -> None:
    anchors, start = Anchors(), CENTRE + np.array([[0.0, 0.0], [40.0, 10.0]])
    anchors.start(started(start), images[0])
    other = start + np.array([[20.0, 0.0], [0.3, 0.0]])
    # Flow of the same image finds each point where it is said to be: the first on ground that is not its anchor's.
    at_other = Flow(images[0], images[0], other, other)
    pixels, seen = anchors.into_left(started(start).ids, at_other)
    assert seen.all()
    np.testing.assert_allclose(pixels, [other[0], start[1]], atol=0.02)
    tracks = dataclasses.replace(started(start), pixels=pixels)
    anchors.start(tracks, images[0])
    pixels, _ = anchors.into_left(tracks.ids, Flow(images[0], images[0], other + 0.3, other + 0.3))
    np.testing.assert_allclose(pixels, [other[0], start[1]], atol=0.02)


def test_a_point_without_a_guess_does_not_disturb_the_others(images: list[FlowImage]) -> None:
    start = some_points()
    guess = moved(start, 2)
    guess[0] = np.nan
    tracks, anchors = started(start), Anchors()
    anchors.start(tracks, images[0])
    flow = Flow(images[0], images[2], start, guess)
    assert flow.turn is not None
    pixels, seen = anchors.into_left(tracks.ids, flow)
    np.testing.assert_array_equal(seen, np.arange(len(start)) > 0)
    assert np.median(np.linalg.norm(pixels - moved(start, 2), axis=1)[1:]) < 0.2


def test_a_new_point_without_an_anchor_is_found_by_flow(images: list[FlowImage]) -> None:
    start = some_points()
    pixels, seen = Anchors().into_left(started(start).ids, Flow(*images[:2], start, start))
    assert seen.mean() > 0.95
    assert np.median(np.linalg.norm(pixels - moved(start, 1), axis=1)[seen]) < 0.1


def test_a_point_without_an_anchor_ends_at_the_border(images: list[FlowImage]) -> None:
    start = np.array([[9.0, 200.0], [250.0, 200.0]])
    anchors, still = Anchors(), Flow(images[0], images[0], start, start)
    anchors.start(started(start), images[0])
    np.testing.assert_array_equal(anchors.into_left(started(start).ids, still)[1], [False, True])


def test_without_tracks_there_are_no_anchors(images: list[FlowImage]) -> None:
    anchors, start = Anchors(), CENTRE[None]
    anchors.start(started(start), images[0])
    none = np.zeros((0, 2))
    assert len(anchors.into_left(Tracks.none().ids, Flow(images[0], images[0], none, none))[0]) == 0
    now = start + 0.3
    pixels, _ = anchors.into_left(started(now).ids, Flow(images[0], images[0], now, now))
    np.testing.assert_allclose(pixels, now, atol=0.02)


def test_a_point_whose_look_changes_gets_a_new_anchor(images: list[FlowImage]) -> None:
    anchors, start = Anchors(), CENTRE[None]
    anchors.start(started(start), images[0])
    changed = FlowImage(np.ascontiguousarray(images[0].grey[::-1]))
    now = start + 0.3
    tracks = started(now)
    pixels, seen = anchors.into_left(tracks.ids, Flow(changed, changed, now, now))
    assert seen.all()
    np.testing.assert_allclose(pixels, now, atol=0.02)
    anchors.start(tracks, changed)
    pixels, _ = anchors.into_left(tracks.ids, Flow(changed, changed, start, start))
    np.testing.assert_allclose(pixels, now, atol=0.02)
