# SPDX-License-Identifier: Apache-2.0
"""ORB [rublee11], by OpenCV: oriented FAST corners with 256 comparisons; no part of [thesis].

Parameters are OpenCV's, which are the authors': eight levels 1.2 apart, patches of 31 px, FAST threshold 20.
"""

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from uav_vslam.config import FrontendConfig
from uav_vslam.vision.features.base import Keypoints, no_keypoints, strongest_first
from uav_vslam.vision.images import to_full_resolution, to_grey8

LEVEL_FACTOR = 1.2
LEVELS = 8
BITS = 256
BORDER_PX = 31  # OpenCV detects no corners there


class OrbExtractor:
    """Corners with descriptors of one number, 0 or 1, per bit: squared Euclidean distance equals Hamming distance."""

    def __init__(self, config: FrontendConfig) -> None:
        """Prepare for at most `max_features` points."""
        self._max_features = config.max_features
        self._orb = cv2.ORB_create(nfeatures=config.max_features, scaleFactor=LEVEL_FACTOR, nlevels=LEVELS)

    def detect(self, image: NDArray[np.generic]) -> Keypoints:
        """Return at most `max_features` keypoints of an image."""
        grey = to_grey8(image)
        if min(grey.shape) <= 2 * BORDER_PX:  # OpenCV fails if a level is empty
            return no_keypoints(BITS)
        points, descriptors = self._orb.detectAndCompute(grey, None)
        if not points:
            return no_keypoints(BITS)
        responses = np.array([point.response for point in points], dtype=np.float32)
        bits = np.unpackbits(np.asarray(descriptors, np.uint8), axis=1)
        return strongest_first(Keypoints(_positions(points, grey.shape), responses, bits), self._max_features)


def _positions(points: Sequence[cv2.KeyPoint], shape: tuple[int, ...]) -> NDArray[np.float32]:
    """Return (N, 2) pixels in an image of (height, width), from the points' positions in their pyramid level.

    OpenCV multiplies by the level's nominal scale, which is off by up to a pixel: levels are resized to whole pixels,
    about pixel centres.
    """
    pixels = np.asarray(cv2.KeyPoint_convert(points), dtype=float).reshape(-1, 2)
    octaves = np.array([point.octave for point in points])
    for octave in np.unique(octaves):
        here, factor = octaves == octave, LEVEL_FACTOR**octave
        level = round(shape[0] / factor), round(shape[1] / factor)
        pixels[here] = to_full_resolution(pixels[here] / factor, level, shape)
    return pixels.astype(np.float32)
