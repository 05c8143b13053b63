# SPDX-License-Identifier: Apache-2.0
"""Images as an ideal pinhole camera would have taken them."""

import dataclasses
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from uav_vslam.geometry.camera import PinholeCamera

Image = NDArray[np.uint8]

BORDER_PX = 1.0  # so far outside the image its border is repeated


def filling_zoom(camera: PinholeCamera, pixels: NDArray[Any], *, border_px: float) -> float:
    """Return the ratio of a pinhole's focal length to the lens's with which it shows only what the lens has imaged.

    Args:
        camera: with the lens.
        pixels: (..., 2) of the pinhole with the lens's focal length.
        border_px: how far beyond its outermost pixels the lens's image may be used.
    """
    centre, corner = camera.centre, np.array([camera.width - 1, camera.height - 1])
    away = camera.distort(pixels) - centre
    room = np.where(away < 0, centre, corner - centre) + border_px
    return max(1.0, float((np.abs(away) / room).max()))


class Undistorter:
    """Removes the lens distortion of one camera; an image without any is passed on as it is.

    Attributes:
        camera: without distortion, and with a longer focal length where the lens would leave parts of its image empty.
    """

    def __init__(self, camera: PinholeCamera) -> None:
        self.camera = dataclasses.replace(camera, distortion=np.zeros(5), model="plumb_bob")
        self._maps: tuple[NDArray[np.int16], NDArray[np.uint16]] | None = None
        if camera.model == "equidistant" or np.any(camera.distortion):
            grid = np.stack(np.meshgrid(np.arange(camera.width), np.arange(camera.height)), axis=-1)
            zoom, centre = filling_zoom(camera, grid, border_px=BORDER_PX), camera.centre
            self.camera = dataclasses.replace(self.camera, fx=zoom * camera.fx, fy=zoom * camera.fy)
            raw = camera.distort(centre + (grid - centre) / zoom).astype(np.float32)
            self._maps = cv2.convertMaps(raw[..., 0], raw[..., 1], cv2.CV_16SC2)

    def apply(self, image: Image) -> Image:
        """Return the (H, W) or (H, W, 3) image undistorted."""
        if self._maps is None:
            return image
        return np.asarray(cv2.remap(image, *self._maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE))
