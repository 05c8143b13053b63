# SPDX-License-Identifier: Apache-2.0
"""Matches that agree on one geometry between the images, by RANSAC: section 3.4.5 of [thesis].

OpenCV's USAC framework with its local optimisation. It draws from a generator of its own, whose seed is given: the same
keypoints give the same matches, whatever ran before.
"""

from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import NDArray

from uav_vslam.vision.features.base import Keypoints
from uav_vslam.vision.matching.nn_ratio import nn_mutual

Pixels = NDArray[np.float32]
Fit = Callable[[Pixels, Pixels, cv2.UsacParams], tuple[object, NDArray[np.uint8] | None]]

HOMOGRAPHY_PX = 3.0  # error of an inlier; the ground is not quite a plane
EPIPOLAR_PX = 1.5  # distance of an inlier from its epipolar line
HOMOGRAPHY_POINTS = 4  # that a homography fits whatever they are
FUNDAMENTAL_POINTS = 7
SEED = 1
CONFIDENCE = 0.999
MAX_ITERATIONS = 5000


def ransac_homography(a: Keypoints, b: Keypoints, ratio: float) -> NDArray[np.intp]:
    """Match mutual nearest descriptors, and keep those that one homography maps onto each other."""
    return _agreeing(nn_mutual(a, b, ratio), a, b, cv2.findHomography, HOMOGRAPHY_POINTS, HOMOGRAPHY_PX)


def ransac_fundamental(a: Keypoints, b: Keypoints, ratio: float) -> NDArray[np.intp]:
    """Match mutual nearest descriptors, and keep those that lie on each other's epipolar lines."""
    return _agreeing(nn_mutual(a, b, ratio), a, b, cv2.findFundamentalMat, FUNDAMENTAL_POINTS, EPIPOLAR_PX)


def _agreeing(
    pairs: NDArray[np.intp], a: Keypoints, b: Keypoints, fit: Fit, sample: int, threshold_px: float
) -> NDArray[np.intp]:
    """Return the matches that agree with the best geometry; none unless there are more than a sample of them."""
    none = pairs[:0]
    if len(pairs) <= sample:
        return none
    parameters = cv2.UsacParams()
    parameters.randomGeneratorState = SEED
    parameters.threshold = threshold_px
    parameters.confidence = CONFIDENCE
    parameters.maxIterations = MAX_ITERATIONS
    try:
        _, inliers = fit(a.pixels[pairs[:, 0]], b.pixels[pairs[:, 1]], parameters)
    except cv2.error:  # degenerate points: OpenCV asserts instead of answering no
        return none
    if inliers is None or int(inliers.sum()) <= sample:
        return none
    return pairs[inliers.ravel().astype(bool)]
