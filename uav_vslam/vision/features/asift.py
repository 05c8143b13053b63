# SPDX-License-Identifier: Apache-2.0
"""Affine SIFT [morel09], section 3.4.2 of [thesis]: SIFT on simulated views, by OpenCV.

As in the paper: tilts 1, sqrt 2, ... 4 sqrt 2, and for a tilt t camera longitudes every 72 deg / t; 43 views in all, at
full resolution (without their two-resolution preselection of views). OpenCV tilts a view by subsampling columns, so
points of tilted views scatter by a quarter of a pixel.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

from uav_vslam.config import FrontendConfig
from uav_vslam.vision.features.base import Keypoints, no_keypoints
from uav_vslam.vision.features.sift import DESCRIPTOR_LENGTH, opencv_sift, sift_keypoints
from uav_vslam.vision.images import to_grey8

MAX_TILT = 5  # exponents of sqrt 2
TILT_STEP = 2.0**0.5
LONGITUDE_STEP_DEG = 72.0
SMALLEST_PX = 16  # side of an image; OpenCV fails if a tilted view is empty


class AffineSiftExtractor:
    """SIFT points of simulated views, mapped back to the original image."""

    def __init__(self, config: FrontendConfig, *, precise: bool = True) -> None:
        """Prepare; the arguments are `SiftExtractor`'s."""
        self._max_features = config.max_features
        views = opencv_sift(config, count=0, precise=precise)
        self._affine = cv2.AffineFeature_create(
            views, maxTilt=MAX_TILT, minTilt=0, tiltStep=TILT_STEP, rotateStepBase=LONGITUDE_STEP_DEG
        )

    def detect(self, image: NDArray[np.generic]) -> Keypoints:
        """Return at most `max_features` keypoints of an image."""
        grey = to_grey8(image)
        if min(grey.shape) < SMALLEST_PX:
            return no_keypoints(DESCRIPTOR_LENGTH)
        points, descriptors = self._affine.detectAndCompute(grey, None)
        return sift_keypoints(points, descriptors, self._max_features)
