# SPDX-License-Identifier: Apache-2.0
"""Associations that start from the nearest descriptor among all landmarks in view, wherever a feature lies.

`nn` is the conventional method of section 6.4 of [thesis]; the others clean up what it finds by where features lie and
where the landmarks are expected. What is expected may be off as a whole: only neighbourhoods count, or one homography.
"""

import numpy as np
from numpy.typing import NDArray

from uav_vslam.association.hgtm import same_shapes
from uav_vslam.association.in_view import InView
from uav_vslam.config import BackendConfig
from uav_vslam.types import StereoFeatures
from uav_vslam.vision.matching.cds import dominating_points
from uav_vslam.vision.matching.gtm import same_neighbours
from uav_vslam.vision.matching.nn_ratio import match_descriptors, squared_distances
from uav_vslam.vision.matching.ransac import same_homography

Pairs = NDArray[np.intp]

FINE_MATCHES = 50  # "the first certain number of pairs" of section 7.4.2


def nn(marks: InView, seen: StereoFeatures, config: BackendConfig) -> Pairs:
    """Match mutual nearest descriptors that pass the ratio test."""
    return match_descriptors(marks.descriptors, seen.descriptors, config.min_descriptor_ratio)


def ransac(marks: InView, seen: StereoFeatures, config: BackendConfig) -> Pairs:
    """Match as `nn` does, and keep what one homography moves from where it is expected."""
    pairs = nn(marks, seen, config)
    return pairs[same_homography(*_left_pixels(marks, seen, pairs))]


def gtm(marks: InView, seen: StereoFeatures, config: BackendConfig) -> Pairs:
    """Match as `nn` does, and keep what has the same neighbours in image and map, section 6.3 of [thesis]."""
    pairs = nn(marks, seen, config)
    return pairs[same_neighbours(*_left_pixels(marks, seen, pairs))]


def hgtm(marks: InView, seen: StereoFeatures, config: BackendConfig) -> Pairs:
    """Match as `nn` does, and keep what forms the same shapes in image and map, section 6.4.2 of [thesis]."""
    pairs = nn(marks, seen, config)
    return pairs[same_shapes(*_left_pixels(marks, seen, pairs))]


def cds(marks: InView, seen: StereoFeatures, config: BackendConfig) -> Pairs:
    """Match as `nn` does, and keep the features of a connected dominating set: few, and spread over the image.

    What is left out still is a rival: without it, a landmark whose feature is left out would be found in another one.
    """
    pairs = nn(marks, seen, config)
    return pairs[np.isin(pairs[:, 1], dominating_points(seen.pixels[:, :2]))]


def coarse_fine(marks: InView, seen: StereoFeatures, config: BackendConfig) -> Pairs:
    """Match mutual nearest descriptors, no matter how near the next is, and take those with the smallest distances.

    The two steps of section 7.4.2 of [thesis].
    """
    pairs = match_descriptors(marks.descriptors, seen.descriptors, 1.0)
    distance2 = squared_distances(marks.descriptors, seen.descriptors)[pairs[:, 0], pairs[:, 1]]
    return pairs[np.sort(np.argsort(distance2, kind="stable")[:FINE_MATCHES])]


def _left_pixels(marks: InView, seen: StereoFeatures, pairs: Pairs) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return (K, 2) where the pairs are expected and where they are, in the left image."""
    return marks.expected[pairs[:, 0], :2], seen.pixels[pairs[:, 1], :2].astype(float)
