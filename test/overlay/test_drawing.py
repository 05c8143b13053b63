# SPDX-License-Identifier: Apache-2.0
"""Overlays on images, and videos of them."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from uav_vslam.errors import UavVslamError
from uav_vslam.overlay.drawing import ASSOCIATED, OTHER, TRAIL, WARNING, captioned, drawn, write_video
from uav_vslam.overlay.tracks import TrackOverlay


def overlay(*, coasted: bool = False) -> TrackOverlay:
    points = np.array([[200.0, 100.0], [60.0, 150.0]])
    trail = np.array([[200.0, 20.0], [200.0, 100.0]])
    return TrackOverlay(1, points, np.array([True, False]), [trail], "1.00 s", coasted)


def painted(pixels: NDArray[np.uint8], colour: tuple[int, int, int]) -> NDArray[np.bool_]:
    """Return which pixels have a colour, up to antialiasing."""
    return np.asarray(np.abs(pixels.astype(int) - colour).sum(axis=-1) < 90)


@pytest.mark.parametrize("shape", [(240, 320), (240, 320, 3)])
@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
def test_points_and_trails_have_their_colours(shape: tuple[int, ...], kind: type) -> None:
    image = np.random.default_rng(0).integers(0, 200, shape).astype(kind)
    before = image.copy()
    canvas = drawn(image, overlay())
    assert canvas.shape == (240, 320, 3)
    assert tuple(canvas[100, 200]) == ASSOCIATED
    assert painted(canvas[50, 195:206], TRAIL).any()
    assert painted(canvas[150, 50:71], OTHER).any()  # a circle, its middle empty
    assert canvas[150, 60].std() == 0  # grey
    np.testing.assert_array_equal(image, before)


def test_a_coasted_frame_has_a_caption_in_red() -> None:
    canvas = drawn(np.full((240, 320), 90, np.uint8), overlay())
    assert painted(captioned(canvas, overlay(coasted=True))[:40], WARNING).any()
    assert not painted(captioned(canvas, overlay()), WARNING).any()
    assert not painted(canvas, WARNING).any()  # the drawn image itself is unchanged


def test_a_video_holds_each_image_in_turn(tmp_path: Path) -> None:
    images = [np.full((120, 160, 3), 25 * k, np.uint8) for k in range(10)]
    path = write_video(tmp_path / "film.mp4", iter(images), 5.0)
    film = cv2.VideoCapture(str(path))
    assert film.get(cv2.CAP_PROP_FPS) == pytest.approx(5.0)
    for image in images:
        read, shown = film.read()
        assert read
        assert abs(float(shown.mean()) - float(image.mean())) < 4.0  # compressed
    assert not film.read()[0]


def test_a_video_that_cannot_be_written_is_refused_with_a_remedy(tmp_path: Path) -> None:
    with pytest.raises(UavVslamError, match="run without --video"):
        write_video(tmp_path / "missing" / "film.mp4", [np.zeros((120, 160, 3), np.uint8)], 5.0)
