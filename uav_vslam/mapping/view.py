# SPDX-License-Identifier: Apache-2.0
"""An image together with its camera and pose: what all mapping starts from."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from uav_vslam.geometry.camera import PinholeCamera
from uav_vslam.geometry.pose import Pose
from uav_vslam.mapping.opacity import Mask
from uav_vslam.vision.images import to_bgr8

Image = NDArray[np.uint8]


@dataclass(frozen=True, slots=True)
class View:
    """One image of the ground.

    Attributes:
        vehicle: which took it.
        stamp_ns: exposure time [ns].
        camera: intrinsics without distortion; the image is already undistorted.
        T_map_cam: camera (optical axes) in the map frame.
        image: (H, W) grey or (H, W, 3) BGR.
        opaque: (H, W) where the image shows something; None everywhere.
    """

    vehicle: str
    stamp_ns: int
    camera: PinholeCamera
    T_map_cam: Pose
    image: Image
    opaque: Mask | None = None

    def in_colour(self) -> "View":
        """Return the view with a BGR image; a grey one gets equal channels."""
        return replace(self, image=to_bgr8(self.image))
