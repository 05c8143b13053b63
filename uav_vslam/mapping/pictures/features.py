# SPDX-License-Identifier: Apache-2.0
"""SIFT points of downscaled pictures, spread over each, and the levels of 16-bit ones."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from uav_vslam.config import FrontendConfig
from uav_vslam.errors import InvalidMessage, PictureError
from uav_vslam.geometry.image_grid import spread
from uav_vslam.mapping.opacity import Mask, within
from uav_vslam.mapping.pictures.picture import Picture
from uav_vslam.mapping.pictures.raw_values import RawValues
from uav_vslam.vision.features.base import Keypoints
from uav_vslam.vision.features.sift import SiftExtractor
from uav_vslam.vision.images import shrink, to_full_resolution, to_grey8

Array = NDArray[np.float64]

LONGEST_SIDE_PX = 1600  # of the image that is searched
MOST_POINTS = 3000
CANDIDATES = 8000  # strongest points, among which those kept are chosen for their spread
CONTRASTS = 0.015, 0.003  # least of a point; the second where there are too few: smooth fields, haze, long shadows
PX_PER_POINT = 100  # a small picture holds no more


@dataclass(frozen=True, slots=True)
class PictureFeatures:
    """Points of one picture.

    Attributes:
        pixels: (N, 2) in the full image [px].
        descriptors: (N, 128) uint8.
    """

    pixels: Array
    descriptors: NDArray[np.uint8]


@dataclass(frozen=True, slots=True)
class Detected:
    """Pictures with their points, in the same order, and the names of those that can't be decoded."""

    pictures: list[Picture]
    features: list[PictureFeatures]
    undecoded: list[str]


def detect_all(pictures: Sequence[Picture], *, on_picture: Callable[[], None]) -> Detected:
    """Return the points of all pictures that can be decoded; 16-bit ones of one camera get the same levels."""
    found = Detected([], [], [])
    values = RawValues()
    for picture in pictures:
        try:
            stored, opaque = picture.stored(), picture.opaque()
            features = detect(stored, opaque)
        except (PictureError, InvalidMessage):
            found.undecoded.append(picture.name)
        else:
            values.add(picture.camera, stored, opaque)
            found.pictures.append(picture)
            found.features.append(features)
        on_picture()
    found.pictures[:] = values.levelled(found.pictures)
    return found


def detect(image: NDArray[np.generic], opaque: Mask | None = None) -> PictureFeatures:
    """Return the points of a grey or BGR image, where it is opaque.

    Raises:
        InvalidMessage: its pixels are of a kind that is not supported.
    """
    small = shrink(image, min(1.0, LONGEST_SIDE_PX / max(image.shape)))
    found = within(_strongest(to_grey8(small)), None if opaque is None else _shrunk(opaque, small.shape[:2]))
    rows = np.sort(spread(found.pixels, MOST_POINTS, size=(small.shape[1], small.shape[0])))
    pixels = to_full_resolution(found.pixels[rows], small.shape[:2], image.shape[:2])
    return PictureFeatures(pixels, found.descriptors[rows])


def _shrunk(opaque: Mask, shape: tuple[int, ...]) -> Mask:
    return cv2.resize(opaque.astype(np.uint8), shape[::-1], interpolation=cv2.INTER_NEAREST) > 0


def _strongest(grey: NDArray[np.uint8]) -> Keypoints:
    """Return the strongest points of an image, enough of them wherever its contrast allows."""
    enough = min(MOST_POINTS, grey.size // PX_PER_POINT)
    for contrast in CONTRASTS:
        extractor = SiftExtractor(FrontendConfig(max_features=CANDIDATES, contrast_threshold=contrast))
        found = extractor.detect(grey)
        if len(found.pixels) >= enough:
            break
    return found
