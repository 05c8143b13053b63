# SPDX-License-Identifier: Apache-2.0
"""Outlier rejection for associations by image geometry, chapter 6 of [thesis].

The prediction may have a common error, so only neighbourhoods, shapes or one homography are compared.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from uav_vslam.association.in_view import Associator, InView
from uav_vslam.config import BackendConfig
from uav_vslam.types import StereoFeatures

Array = NDArray[np.float64]
Pairs = NDArray[np.intp]
InlierSelection = Callable[[Array, Array], NDArray[np.intp]]


def with_outlier_rejection(associate: Associator, inliers: InlierSelection) -> Associator:
    """Add outlier rejection to an associator.

    Args:
        associate: whose matches are filtered.
        inliers: (N, 2) predicted and (N, 2) observed left pixels [px] -> rows of the inliers.
    """

    def associate_and_reject(in_view: InView, seen: StereoFeatures, config: BackendConfig) -> Pairs:
        pairs = associate(in_view, seen, config)
        return pairs[inliers(in_view.expected[pairs[:, 0], :2], seen.pixels[pairs[:, 1], :2].astype(float))]

    return associate_and_reject
