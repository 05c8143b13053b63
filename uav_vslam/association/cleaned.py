# SPDX-License-Identifier: Apache-2.0
"""Associations cleaned up by where features lie and where the landmarks are expected, chapter 6 of [thesis].

What is expected may be off as a whole: only neighbourhoods and shapes count, or one homography.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from uav_vslam.association.in_view import Associator, InView
from uav_vslam.config import BackendConfig
from uav_vslam.types import StereoFeatures

Array = NDArray[np.float64]
Pairs = NDArray[np.intp]
CleanUp = Callable[[Array, Array], NDArray[np.intp]]


def cleaned(associate: Associator, keep: CleanUp) -> Associator:
    """Make an associator of another one.

    Args:
        associate: what is to be cleaned up.
        keep: (N, 2) where the landmarks are expected in the left image and (N, 2) where they were found [px] -> rows.
    """

    def associate_and_clean(in_view: InView, seen: StereoFeatures, config: BackendConfig) -> Pairs:
        pairs = associate(in_view, seen, config)
        return pairs[keep(in_view.expected[pairs[:, 0], :2], seen.pixels[pairs[:, 1], :2].astype(float))]

    return associate_and_clean
