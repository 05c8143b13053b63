# SPDX-License-Identifier: Apache-2.0
"""Data association by the nearest descriptor among all landmarks in view, without a gate."""

import numpy as np
from numpy.typing import NDArray

from uav_vslam.association.in_view import InView
from uav_vslam.config import BackendConfig
from uav_vslam.types import StereoFeatures
from uav_vslam.vision.matching.cds import dominating_points
from uav_vslam.vision.matching.nn_ratio import match_descriptors, squared_distances

Pairs = NDArray[np.intp]

FINE_MATCHES = 50  # "the first certain number of pairs" of section 7.4.2


def nn(in_view: InView, seen: StereoFeatures, config: BackendConfig) -> Pairs:
    """Match mutual nearest descriptors that pass the ratio test: the conventional method of section 6.4 of [thesis]."""
    return match_descriptors(in_view.descriptors, seen.descriptors, config.min_descriptor_ratio)


def cds(in_view: InView, seen: StereoFeatures, config: BackendConfig) -> Pairs:
    """Match as `nn` does, and keep only features of a connected dominating set: few, spread over the image.

    Other features still count in the ratio test: otherwise their landmarks would match a wrong feature.
    """
    pairs = nn(in_view, seen, config)
    return pairs[np.isin(pairs[:, 1], dominating_points(seen.pixels[:, :2]))]


def coarse_fine(in_view: InView, seen: StereoFeatures, config: BackendConfig) -> Pairs:
    """Match mutual nearest descriptors without ratio test, and keep those with the smallest distances.

    The two steps of section 7.4.2 of [thesis].
    """
    pairs = match_descriptors(in_view.descriptors, seen.descriptors, 1.0)
    distance2 = squared_distances(in_view.descriptors, seen.descriptors)[pairs[:, 0], pairs[:, 1]]
    return pairs[np.sort(np.argsort(distance2, kind="stable")[:FINE_MATCHES])]
