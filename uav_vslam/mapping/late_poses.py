# SPDX-License-Identifier: Apache-2.0
"""Images wait for their poses, which leave the filter's window a second or two later."""

from collections import OrderedDict

import numpy as np
from numpy.typing import NDArray

from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.stereo import StereoRig
from uav_vslam.mapping.flight_views import LeftCamera
from uav_vslam.mapping.view import View

MAX_WAITING = 60  # images: 3 s at 20 Hz


class LatePoses:
    """Makes views of one vehicle's left images and poses, in stamp order.

    Attributes:
        dropped: images that waited for too long, or whose pose was passed over.
    """

    def __init__(self, vehicle: str, rig: StereoRig) -> None:
        self._camera = LeftCamera(vehicle, rig)
        self._images: OrderedDict[int, NDArray[np.generic]] = OrderedDict()
        self.dropped = 0

    def add_image(self, stamp_ns: int, pixels: NDArray[np.generic]) -> None:
        """Hold an image, grey or BGR; the oldest one gives way if too many wait."""
        self._images[stamp_ns] = pixels
        if len(self._images) > MAX_WAITING:
            self._images.popitem(last=False)
            self.dropped += 1

    def add_pose(self, stamp_ns: int, T_map_body: Pose) -> View | None:
        """Return the view of that stamp; None if its image is not there. Older images are given up.

        Raises:
            InvalidMessage: the image has another size than the calibration, or a type that can't be used.
        """
        while self._images and next(iter(self._images)) < stamp_ns:
            self._images.popitem(last=False)
            self.dropped += 1
        pixels = self._images.pop(stamp_ns, None)
        return None if pixels is None else self._camera.view(stamp_ns, pixels, T_map_body)
