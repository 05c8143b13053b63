# SPDX-License-Identifier: Apache-2.0
"""SURF [bay08], section 3.4.4 of [thesis], by mahotas, an optional dependency: OpenCV's wheels do not include it.

The threshold is OpenSURF's 0.0004 for images of 0 to 1. Differences from the paper:
- One octave of eight box filters, 9 to 51 px wide in steps of 6, at every other pixel, spans the paper's first two
  octaves: mahotas starts its higher octaves so far from the border that common images have no points in them.
- Descriptors are rounded to steps of 1/255. The sign of the Laplacian, by which the paper does not compare dark with
  bright blobs, is a 65th number that puts them at least one descriptor length apart.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

from uav_vslam.config import FrontendConfig
from uav_vslam.errors import ConfigError
from uav_vslam.vision.features.base import Keypoints, no_keypoints, strongest_first
from uav_vslam.vision.images import to_grey8

DESCRIPTOR_LENGTH = 65
FILTERS = 8  # box filters 9, 15, ... 51 px wide
STEP_PX = 2  # between filter positions
THRESHOLD = 0.0004 * 255.0**2  # of the determinant of the Hessian
LEVELS = 255  # of a descriptor of length one
ZERO_LEVEL = 128
PADDING_PX = 96  # the largest descriptor reaches 31/2 * 6 px: no point is lost at the border; a multiple of the step
INSTALL = "pip install mahotas==1.4.19"


class SurfExtractor:
    """Blobs of the box-filtered Hessian with sums of Haar wavelets."""

    def __init__(self, config: FrontendConfig) -> None:
        """Prepare for at most `max_features` points.

        Raises:
            ConfigError: mahotas is not installed.
        """
        try:
            from mahotas.features import surf
        except ImportError:
            raise ConfigError(f"extractor 'surf' needs the package mahotas; install it: {INSTALL}") from None
        self._surf = surf
        self._max_features = config.max_features

    def detect(self, image: NDArray[np.generic]) -> Keypoints:
        """Return at most `max_features` keypoints of an image."""
        grey = to_grey8(image)
        padded = cv2.copyMakeBorder(grey, *[PADDING_PX] * 4, cv2.BORDER_REPLICATE)
        integral = self._surf.integral(padded)
        points = self._surf.interest_points(integral, 1, FILTERS, STEP_PX, threshold=THRESHOLD, is_integral=True)
        found = self._surf.descriptors(integral, _corrected(points), is_integral=True)
        pixels = found[:, 1::-1] - PADDING_PX
        inside = ((pixels >= -0.5) & (pixels < np.array(grey.shape[::-1]) - 0.5)).all(axis=1)
        if not inside.any():
            return no_keypoints(DESCRIPTOR_LENGTH)
        responses, laplacian, values = found[inside, 3], found[inside, 4], found[inside, 6:]
        keypoints = Keypoints(
            pixels[inside].astype(np.float32), responses.astype(np.float32), _descriptors(values, laplacian)
        )
        return strongest_first(keypoints, self._max_features)


def _corrected(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return (N, 5) points (y, x, scale, ...) corrected for two defects of mahotas 1.4.

    Its subpixel step has the wrong sign. Its wavelets have one half too wide, so they respond to brightness, if twice
    the scale rounds to an odd number: such scales are moved, by at most a tenth, to the nearest that rounds to an even
    one.
    """
    corrected = points.copy()
    corrected[:, :2] = 2.0 * STEP_PX * np.rint(points[:, :2] / STEP_PX) - points[:, :2]
    even = np.rint(points[:, 2])
    corrected[:, 2] = np.clip(points[:, 2], even - 0.25, even + 0.249)
    return corrected


def _descriptors(values: NDArray[np.float64], laplacian: NDArray[np.float64]) -> NDArray[np.uint8]:
    """Return (N, 65) uint8 of (N, 64) numbers, with rows of norm at most one, and the (N,) Laplacian's signs."""
    rounded = np.clip(np.rint(ZERO_LEVEL + LEVELS * values), 0, 255)
    sign = np.where(laplacian > 0, LEVELS, 0)
    return np.asarray(np.hstack([rounded, sign[:, None]]), np.uint8)
