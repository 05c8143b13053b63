# SPDX-License-Identifier: Apache-2.0
"""SIFT [lowe04], section 3.4.1 of [thesis], by OpenCV.

Parameters are Lowe's (three layers an octave, sigma 1.6, edges up to a ratio of curvatures of 10) except the contrast
threshold: his 0.03 is 0.04 in OpenCV's scale; `frontend.contrast_threshold` is lower, for low-contrast grass.
"""

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from uav_vslam.config import FrontendConfig
from uav_vslam.vision.features.base import Choice, Keypoints, by_strength, no_keypoints, strongest_first
from uav_vslam.vision.images import to_grey8

DESCRIPTOR_LENGTH = 128
OCTAVE_LAYERS = 3
EDGE_THRESHOLD = 10.0
SIGMA = 1.6


class SiftExtractor:
    """Difference-of-Gaussian points with 128-byte descriptors, which OpenCV rounds to 0..255 itself."""

    def __init__(self, config: FrontendConfig, *, precise: bool = True) -> None:
        """Prepare.

        Args:
            config: number of points and contrast threshold.
            precise: precise upscaling. False is OpenCV's default, for compatibility: every point is biased by a quarter
                of a pixel, half a pixel at full resolution.
        """
        self._max_features = config.max_features
        self._sift = opencv_sift(config, count=config.max_features, precise=precise)

    def detect(self, image: NDArray[np.generic]) -> Keypoints:
        """Return at most `max_features` keypoints of an image."""
        points, descriptors = self._sift.detectAndCompute(to_grey8(image), None)
        return sift_keypoints(points, descriptors, self._max_features)

    def detect_chosen(self, image: NDArray[np.generic], choose: Choice) -> Keypoints:
        """Return the chosen ones of an image's keypoints; a thousand descriptors take twice the detection's time."""
        grey = to_grey8(image)
        points = self._sift.detect(grey, None)
        if not points:
            return no_keypoints(DESCRIPTOR_LENGTH)
        pixels, responses = _positions(points)
        order = by_strength(pixels, responses)[: self._max_features]
        rows = order[choose(pixels[order])]
        if len(rows) == 0:
            return no_keypoints(DESCRIPTOR_LENGTH)
        _, descriptors = self._sift.compute(grey, [points[row] for row in rows])
        return Keypoints(pixels[rows], responses[rows], np.asarray(descriptors, np.uint8))


def opencv_sift(config: FrontendConfig, *, count: int, precise: bool) -> cv2.SIFT:
    """Return OpenCV's SIFT; a `count` of 0 keeps all points."""
    return cv2.SIFT_create(
        nfeatures=count,
        nOctaveLayers=OCTAVE_LAYERS,
        contrastThreshold=config.contrast_threshold,
        edgeThreshold=EDGE_THRESHOLD,
        sigma=SIGMA,
        descriptorType=cv2.CV_8U,
        enable_precise_upscale=precise,
    )


def sift_keypoints(points: Sequence[cv2.KeyPoint], descriptors: NDArray[np.uint8] | None, count: int) -> Keypoints:
    """Return the `count` strongest of OpenCV's points."""
    if not points:
        return no_keypoints(DESCRIPTOR_LENGTH)
    pixels, responses = _positions(points)
    return strongest_first(Keypoints(pixels, responses, np.asarray(descriptors, np.uint8)), count)


def _positions(points: Sequence[cv2.KeyPoint]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return (N, 2) pixels and (N,) responses of OpenCV's points."""
    pixels = np.asarray(cv2.KeyPoint_convert(points), dtype=np.float32).reshape(-1, 2)
    return pixels, np.array([point.response for point in points], dtype=np.float32)
