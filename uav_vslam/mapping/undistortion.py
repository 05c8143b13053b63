# SPDX-License-Identifier: Apache-2.0
"""Images as an ideal pinhole camera would have taken them."""

import dataclasses

import cv2
import numpy as np
from numpy.typing import NDArray

from uav_vslam.geometry.camera import PinholeCamera

Image = NDArray[np.uint8]


class Undistorter:
    """Removes the lens distortion of one camera; an image without any is passed on as it is.

    Attributes:
        camera: the same intrinsics without distortion.
    """

    def __init__(self, camera: PinholeCamera) -> None:
        self.camera = dataclasses.replace(camera, distortion=np.zeros(5), model="plumb_bob")
        self._maps: tuple[NDArray[np.int16], NDArray[np.uint16]] | None = None
        if camera.model == "equidistant" or np.any(camera.distortion):
            grid = np.stack(np.meshgrid(np.arange(camera.width), np.arange(camera.height)), axis=-1)
            raw = camera.distort(grid).astype(np.float32)
            self._maps = cv2.convertMaps(raw[..., 0], raw[..., 1], cv2.CV_16SC2)

    def apply(self, image: Image) -> Image:
        """Return the (H, W) or (H, W, 3) image undistorted; black where nothing was imaged."""
        if self._maps is None:
            return image
        return np.asarray(cv2.remap(image, *self._maps, cv2.INTER_LINEAR))
