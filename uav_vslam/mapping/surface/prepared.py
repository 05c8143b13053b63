# SPDX-License-Identifier: Apache-2.0
"""A view as the matcher needs it: grey and small, so that many fit into memory."""

import dataclasses
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from uav_vslam.geometry.camera import PinholeCamera
from uav_vslam.geometry.pose import Pose
from uav_vslam.mapping.view import View
from uav_vslam.vision.images import shrink, to_grey8

Grey = NDArray[np.uint8]


@dataclass(frozen=True, slots=True)
class PreparedView:
    """A downscaled grey view.

    Attributes:
        camera: of the downscaled image, without distortion.
        T_map_cam: camera (optical axes) in the map frame.
        grey: (H, W) image.
    """

    camera: PinholeCamera
    T_map_cam: Pose
    grey: Grey

    @staticmethod
    def of(view: View, scale: float) -> "PreparedView":
        """Downscale a view."""
        grey = to_grey8(shrink(view.image, scale))
        return PreparedView(resized(view.camera, grey.shape), view.T_map_cam, grey)

    def smaller(self, scale: float) -> "PreparedView":
        """Downscale further."""
        grey = shrink(self.grey, scale)
        return dataclasses.replace(self, camera=resized(self.camera, grey.shape), grey=grey)


def resized(camera: PinholeCamera, shape: tuple[int, ...]) -> PinholeCamera:
    """Return the camera of an image resized to (height, width); pixel centres are at integers."""
    sy, sx = shape[0] / camera.height, shape[1] / camera.width
    return dataclasses.replace(
        camera,
        width=shape[1],
        height=shape[0],
        fx=camera.fx * sx,
        fy=camera.fy * sy,
        cx=(camera.cx + 0.5) * sx - 0.5,
        cy=(camera.cy + 0.5) * sy - 0.5,
    )
