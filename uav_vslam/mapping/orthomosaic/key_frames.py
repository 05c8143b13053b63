# SPDX-License-Identifier: Apache-2.0
"""Enough views to see all ground well, and no more: each costs time and a seam."""

from collections import deque

import numpy as np

from uav_vslam.mapping.orthomosaic.footprint import outline, overlap
from uav_vslam.mapping.orthomosaic.rectification import sharpness_of
from uav_vslam.mapping.view import View

OVERLAP = 0.7
URGENT_OVERLAP = 0.55  # at which a blurred view is better than none
LEAST_SHARPNESS = 0.75  # of the median of the views before
REMEMBERED = 15  # views over which that median is taken


class KeyFrames:
    """Chooses views of one vehicle as they come."""

    def __init__(self) -> None:
        self._last: np.ndarray | None = None
        self._sharpness: deque[float] = deque(maxlen=REMEMBERED)

    def takes(self, view: View, height_m: float) -> bool:
        """Return whether the view is a key frame.

        Args:
            view: the next one.
            height_m: of the ground below, roughly [m].
        """
        sharpness = sharpness_of(view.image)
        self._sharpness.append(sharpness)
        seen = outline(view.camera, view.T_map_cam, height_m)
        if self._last is not None:
            common = overlap(seen, self._last)
            blurred = sharpness < LEAST_SHARPNESS * float(np.median(self._sharpness))
            if common > (URGENT_OVERLAP if blurred else OVERLAP):
                return False
        self._last = seen
        return True
