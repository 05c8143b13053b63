# SPDX-License-Identifier: Apache-2.0
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from picture_folder import flight, render

from uav_vslam.mapping.pictures.features import detect, detect_all
from uav_vslam.mapping.pictures.pairs import match_pair
from uav_vslam.mapping.pictures.reading import read_folder


@pytest.mark.parametrize(("quality", "grey_levels"), [(None, 3.0), (80, 4.0)], ids=["png", "jpeg"])
def test_pictures_of_little_contrast_are_matched_where_they_overlap(quality: int | None, grey_levels: float) -> None:
    flown = flight(1, 3, along_m=25.0)  # the first and the last share an eighth
    images = [hazy(image, grey_levels, quality) for image in render(flown)]
    features = [detect(image) for image in images]
    sides = (flown.camera.width, flown.camera.width)
    for k in (0, 1):
        matched = match_pair(features[k], features[k + 1], sides)
        assert matched is not None
        assert np.hypot(*matched[1][0]) == pytest.approx(1.0, abs=0.1)  # they were flown at one height


def hazy(image: NDArray[np.uint8], rms: float, quality: int | None) -> NDArray[np.uint8]:
    """Return an image whose contrast is so many grey levels, after JPEG of a quality or None."""
    values = image.astype(float)
    pale = np.clip(np.rint(150.0 + rms * (values - values.mean()) / values.std()), 0, 255).astype(np.uint8)
    if quality is None:
        return pale
    _, file = cv2.imencode(".jpg", pale, [cv2.IMWRITE_JPEG_QUALITY, quality])
    return np.asarray(cv2.imdecode(file, cv2.IMREAD_GRAYSCALE), np.uint8)


def read_together(values: list[NDArray[np.floating]], folder: Path) -> list[NDArray[np.uint8]]:
    """Write 16-bit images, detect points in all of them, and return them as they are then read."""
    for k, image in enumerate(values):
        cv2.imwrite(str(folder / f"{k}.png"), np.rint(image).astype(np.uint16))
    return [picture.read()[..., 0] for picture in detect_all(read_folder(folder).pictures, on_picture=int).pictures]


def test_exposures_of_16_bit_pictures_remain_factors_of_their_brightness(tmp_path: Path) -> None:
    ground = np.random.default_rng(1).uniform(1000.0, 8000.0, (60, 80))
    ground[:, 40:] *= 0.5  # what is in a picture shall not matter
    first, second = read_together([ground, 0.8 * ground], tmp_path)
    usable = (second > 25) & (first < 255)
    assert usable.mean() > 0.7
    assert second[usable] / first[usable].astype(float) == pytest.approx(0.8, abs=0.05)


def test_equal_temperatures_are_equally_grey_in_all_16_bit_pictures(tmp_path: Path) -> None:
    kelvin_100 = np.random.default_rng(1).uniform(28_000.0, 29_000.0, (60, 80))
    warmer = kelvin_100.copy()
    warmer[:30] += 1500.0
    first, second = read_together([kelvin_100, warmer], tmp_path)
    np.testing.assert_array_equal(first[30:], second[30:])
    assert first.std() > 20.0  # grey levels: the range of both together is stretched
