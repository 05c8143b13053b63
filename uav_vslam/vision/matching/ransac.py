# SPDX-License-Identifier: Apache-2.0
"""Matches consistent with one two-view geometry, by RANSAC: section 3.4.5 of [thesis].

OpenCV's USAC framework with local optimisation and a fixed seed: the same keypoints always give the same matches.
"""

from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import NDArray

from uav_vslam.vision.features.base import Keypoints
from uav_vslam.vision.matching.nn_ratio import nn_mutual

Pixels = NDArray[np.float32]
Rows = NDArray[np.intp]
Fit = Callable[[Pixels, Pixels, cv2.UsacParams], tuple[object, NDArray[np.uint8] | None]]

HOMOGRAPHY_PX = 3.0  # reprojection error of an inlier; the ground is not exactly a plane
EPIPOLAR_PX = 1.5  # distance of an inlier from its epipolar line
HOMOGRAPHY_POINTS = 4  # that always fit a homography
FUNDAMENTAL_POINTS = 7
SEED = 1
CONFIDENCE = 0.999
MAX_ITERATIONS = 5000


def ransac_homography(a: Keypoints, b: Keypoints, ratio: float) -> NDArray[np.intp]:
    """Match mutual nearest descriptors, and keep the inliers of a homography."""
    pairs = nn_mutual(a, b, ratio)
    return pairs[same_homography(a.pixels[pairs[:, 0]], b.pixels[pairs[:, 1]])]


def ransac_fundamental(a: Keypoints, b: Keypoints, ratio: float) -> NDArray[np.intp]:
    """Match mutual nearest descriptors, and keep the inliers of a fundamental matrix."""
    pairs = nn_mutual(a, b, ratio)
    return pairs[same_epipolar_geometry(a.pixels[pairs[:, 0]], b.pixels[pairs[:, 1]])]


def same_homography(a: NDArray[np.floating], b: NDArray[np.floating]) -> Rows:
    """Return the ascending rows of (N, 2) pixels `a` and `b` that are inliers of the best homography."""
    return _agreeing(a, b, cv2.findHomography, HOMOGRAPHY_POINTS, HOMOGRAPHY_PX)


def same_epipolar_geometry(a: NDArray[np.floating], b: NDArray[np.floating]) -> Rows:
    """Return the ascending rows of (N, 2) pixels `a` and `b` that are inliers of the best fundamental matrix."""
    return _agreeing(a, b, cv2.findFundamentalMat, FUNDAMENTAL_POINTS, EPIPOLAR_PX)


def _agreeing(a: NDArray[np.floating], b: NDArray[np.floating], fit: Fit, sample: int, threshold_px: float) -> Rows:
    """Return the inliers of the best model; none unless there are more than in a minimal sample."""
    none = np.zeros(0, np.intp)
    if len(a) <= sample:
        return none
    parameters = cv2.UsacParams()
    parameters.randomGeneratorState = SEED
    parameters.threshold = threshold_px
    parameters.confidence = CONFIDENCE
    parameters.maxIterations = MAX_ITERATIONS
    try:
        _, inliers = fit(np.asarray(a, np.float32), np.asarray(b, np.float32), parameters)
    except cv2.error:  # degenerate points: OpenCV fails an assertion
        return none
    if inliers is None or int(inliers.sum()) <= sample:
        return none
    return np.flatnonzero(inliers)
