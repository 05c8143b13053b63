# SPDX-License-Identifier: Apache-2.0
"""SIFT descriptors on a grid, upright and of one size: section 3.4.3.2 of [thesis], as VLFeat's `vl_dsift` [vedaldi10].

As there, a spatial bin is `bin_px` wide and the image is smoothed to a scale of `bin_px / magnification`, assuming
0.5 px from the camera. Differences from VLFeat:
- The descriptors are OpenCV's, at integer pixels, with Lowe's Gaussian window of two bins (VLFeat's own is 2 too).
- The step isn't fixed: it is the smallest that gives at most `max_features` points.
- Points whose contrast, the mean gradient magnitude over the descriptor, is no more than noise are dropped; VLFeat
  keeps them.

Grid points do not move with the scene, so a match is accurate to half a step only: good for image recognition, bad for
triangulation.
"""

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from uav_vslam.config import FrontendConfig
from uav_vslam.vision.features.base import Keypoints, strongest_first
from uav_vslam.vision.features.sift import DESCRIPTOR_LENGTH
from uav_vslam.vision.images import to_grey8

BIN_PX = 8.0  # VLFeat's tutorial
MAGNIFICATION = 3.0  # bin width / scale, Lowe's
CONTRAST_THRESHOLD = 0.25  # mean gradient [grey levels per px]; white noise of two levels leaves 0.1 after smoothing
BINS = 4  # along each side of a descriptor
OPENCV_SIZE_BINS = 1.5  # OpenCV's bins are this many keypoint sizes wide: three sigma, and a size is two


class DenseSiftExtractor:
    """Upright SIFT descriptors on a grid."""

    def __init__(self, config: FrontendConfig) -> None:
        """Prepare for at most `max_features` points."""
        self._max_features = config.max_features

    def detect(self, image: NDArray[np.generic]) -> Keypoints:
        """Return at most `max_features` points of an image, those with the greatest contrast first."""
        grey = to_grey8(image)
        pixels = grid(grey.shape, margin_px=0.5 * BINS * BIN_PX, count=self._max_features)
        contrast = contrast_at(grey, pixels, BIN_PX, MAGNIFICATION)
        good = contrast >= CONTRAST_THRESHOLD
        descriptors = describe(grey, pixels[good], BIN_PX, MAGNIFICATION)
        return strongest_first(Keypoints(pixels[good], contrast[good], descriptors), self._max_features)


def grid(shape: tuple[int, ...], *, margin_px: float, count: int) -> NDArray[np.float32]:
    """Return (N, 2) integer pixels of the densest square grid of at most `count` points.

    Args:
        shape: (height, width) of the image [px].
        margin_px: distance to the border; too small an image has no point.
        count: largest N.
    """
    first = math.ceil(margin_px)
    height, width = (max(0, size - 2 * first) for size in shape[:2])
    step = max(1, math.isqrt(height * width // count))
    while len(range(0, height, step)) * len(range(0, width, step)) > count:
        step += 1
    u, v = np.meshgrid(np.arange(0, width, step), np.arange(0, height, step))
    return np.asarray(np.stack([u.ravel(), v.ravel()], axis=1) + first, np.float32)


def describe(
    channel: NDArray[np.uint8], pixels: NDArray[np.float32], bin_px: float, magnification: float
) -> NDArray[np.uint8]:
    """Return (N, 128) upright SIFT descriptors of an (H, W) channel at (N, 2) integer pixels."""
    if not len(pixels):
        return np.zeros((0, DESCRIPTOR_LENGTH), np.uint8)
    points = [cv2.KeyPoint(u, v, size=bin_px / OPENCV_SIZE_BINS, angle=0.0) for u, v in pixels.tolist()]
    # One layer of one octave: only its first image, smoothed to sigma, is used. The thresholds concern the detector.
    sift = cv2.SIFT_create(0, 1, 0.0, 0.0, bin_px / magnification, cv2.CV_8U)
    _, descriptors = sift.compute(channel, points)
    return np.asarray(descriptors, np.uint8)


def contrast_at(
    channel: NDArray[np.uint8], pixels: NDArray[np.float32], bin_px: float, magnification: float
) -> NDArray[np.float32]:
    """Return the (N,) mean length of the smoothed channel's gradient over each descriptor [grey levels per px]."""
    sigma = max((bin_px / magnification) ** 2 - 0.25, 0.01) ** 0.5
    smooth = cv2.GaussianBlur(channel.astype(np.float32), (0, 0), sigma)
    gradient = cv2.magnitude(cv2.Sobel(smooth, -1, 1, 0, ksize=1), cv2.Sobel(smooth, -1, 0, 1, ksize=1)) * 0.5
    size = round(BINS * bin_px)
    mean = cv2.blur(gradient, (size, size))
    columns, rows = pixels.astype(np.intp).T
    return np.asarray(mean[rows, columns], np.float32)
