# SPDX-License-Identifier: Apache-2.0
"""Matchers of two images' keypoints by name, section 3.4.5 and chapter 6 of [thesis].

`gtm` is the thesis's NN + GTM, as GTM rejects outliers of given matches; `cds_nn` and `cds_gtm` match a few points
spread over the first image. `match_descriptors` and `match_gated` are the underlying array functions.
"""

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from uav_vslam.vision.features.base import Keypoints
from uav_vslam.vision.matching.cds import cds_gtm, cds_nn
from uav_vslam.vision.matching.gtm import gtm
from uav_vslam.vision.matching.nn_ratio import match_descriptors, match_gated, nn, nn_mutual
from uav_vslam.vision.matching.ransac import ransac_fundamental, ransac_homography

__all__ = ["MATCHERS", "Matcher", "match_descriptors", "match_gated"]


class Matcher(Protocol):
    """Matches the keypoints of two images; deterministic."""

    def __call__(self, a: Keypoints, b: Keypoints, ratio: float) -> NDArray[np.intp]:
        """Return (M, 2) indices into `a` and `b`, ascending in `a`, each of `a` at most once.

        Args:
            a, b: keypoints of the two images.
            ratio: the nearest descriptor must be closer than this times the second nearest.
        """
        ...


MATCHERS: dict[str, Matcher] = {
    "nn": nn,
    "nn_mutual": nn_mutual,
    "ransac_homography": ransac_homography,
    "ransac_fundamental": ransac_fundamental,
    "gtm": gtm,
    "cds_nn": cds_nn,
    "cds_gtm": cds_gtm,
}
