# SPDX-License-Identifier: Apache-2.0
"""The orthomosaic of a flight that goes on: key frames, each drawn as soon as the ground below it is mapped."""

from collections import deque

import numpy as np

from uav_vslam.mapping.orthomosaic.key_frames import KeyFrames
from uav_vslam.mapping.orthomosaic.mosaic import Orthomosaic
from uav_vslam.mapping.view import View

MOST_WAITING = 12  # key frames in memory: a vehicle that circles on the spot never gets far away


class FlownOrthomosaic:
    """Feeds a mosaic with the views of one vehicle, in stamp order.

    Attributes:
        mosaic: what is drawn so far.
    """

    def __init__(self, mosaic: Orthomosaic, *, settled_ratio: float) -> None:
        """Start without views.

        Args:
            mosaic: empty.
            settled_ratio: distance from a view over its height, beyond which no later one maps the ground below it.
        """
        self.mosaic = mosaic
        self._settled_ratio = settled_ratio
        self._keys = KeyFrames()
        self._waiting: deque[View] = deque()

    def add(self, view: View, ground_m: float) -> None:
        """Take the next view, over a ground of about this height [m]; draw those that have waited long enough."""
        if self._keys.takes(view, ground_m):
            self._waiting.append(view)
        settled_m = self._settled_ratio * (view.T_map_cam.t[2] - ground_m)
        while self._waiting and (
            np.linalg.norm(self._waiting[0].T_map_cam.t - view.T_map_cam.t) > settled_m
            or len(self._waiting) > MOST_WAITING
        ):
            self.mosaic.add(self._waiting.popleft())

    def finish(self) -> None:
        """Draw the views that still wait."""
        while self._waiting:
            self.mosaic.add(self._waiting.popleft())
