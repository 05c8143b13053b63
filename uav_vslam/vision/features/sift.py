# SPDX-License-Identifier: Apache-2.0
"""SIFT (Lowe 2004), section 3.3 of [thesis], by OpenCV."""

import cv2
import numpy as np
from numpy.typing import NDArray

from uav_vslam.config import FrontendConfig
from uav_vslam.vision.features.base import Keypoints, strongest_first

DESCRIPTOR_LENGTH = 128
OCTAVE_LAYERS = 3
EDGE_THRESHOLD = 10.0
SIGMA = 1.6


class SiftExtractor:
    """Difference-of-Gaussian points with 128-byte descriptors, which OpenCV rounds to 0..255 itself."""

    def __init__(self, config: FrontendConfig) -> None:
        self._max_features = config.max_features
        # Without precise upscaling every point would be off by a quarter of a pixel (OpenCV's default, kept by it
        # for compatibility): half a pixel at full resolution, a bias that no average removes.
        self._sift = cv2.SIFT_create(
            nfeatures=config.max_features,
            nOctaveLayers=OCTAVE_LAYERS,
            contrastThreshold=config.contrast_threshold,
            edgeThreshold=EDGE_THRESHOLD,
            sigma=SIGMA,
            descriptorType=cv2.CV_8U,
            enable_precise_upscale=True,
        )

    def detect(self, image: NDArray[np.uint8]) -> Keypoints:
        """Return at most `max_features` keypoints of an (H, W) grey image."""
        points, descriptors = self._sift.detectAndCompute(image, None)
        if not points:
            return Keypoints(
                np.zeros((0, 2), np.float32), np.zeros(0, np.float32), np.zeros((0, DESCRIPTOR_LENGTH), np.uint8)
            )
        pixels = np.asarray(cv2.KeyPoint_convert(points), dtype=np.float32).reshape(-1, 2)
        responses = np.array([point.response for point in points], dtype=np.float32)
        return strongest_first(Keypoints(pixels, responses, np.asarray(descriptors, np.uint8)), self._max_features)
