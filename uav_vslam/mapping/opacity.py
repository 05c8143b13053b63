# SPDX-License-Identifier: Apache-2.0
"""Pictures that do not fill their image: what is transparent is no part of them."""

import cv2
import numpy as np
from numpy.typing import NDArray

from uav_vslam.vision.features.base import Keypoints

Image = NDArray[np.uint8]
Mask = NDArray[np.bool_]

SUPPORT_PX = 16  # around a point, which its descriptor shows


def within(points: Keypoints, opaque: Mask | None) -> Keypoints:
    """Return the points of an image around which nothing is transparent.

    Args:
        points: of the image.
        opaque: (H, W) where the image is not transparent; None everywhere.
    """
    if opaque is None:
        return points
    away_px = cv2.distanceTransform(opaque.astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    u, v = np.rint(points.pixels).astype(int).T
    return points.chosen(np.flatnonzero(away_px[v, u] > SUPPORT_PX))


def with_alpha(image: Image, opaque: Mask | None) -> Image:
    """Return a BGR image as BGRA, or as it is where all of it is opaque."""
    return image if opaque is None else np.dstack([image, np.where(opaque, np.uint8(255), np.uint8(0))])


def without_alpha(image: Image) -> tuple[Image, Mask | None]:
    """Return a grey, BGR or BGRA image as grey or BGR, and where it is opaque; None everywhere."""
    if image.ndim == 3 and image.shape[2] == 4:
        return np.ascontiguousarray(image[..., :3]), image[..., 3] > 0
    return image, None
