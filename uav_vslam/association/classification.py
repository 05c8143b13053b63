# SPDX-License-Identifier: Apache-2.0
"""Each landmark is a class of descriptors: section 6.4.1 of [thesis].

A feature belongs to the class whose mean is nearest by Mahalanobis distance, sqrt((d - mu)^T Sigma^-1 (d - mu)).
Components that vary between views of a landmark have little weight, and one outlying view does not replace the mean.
"""

import numpy as np
from numpy.typing import NDArray

from uav_vslam.association.descriptor_statistics import DescriptorStatistics
from uav_vslam.association.guided import gate
from uav_vslam.association.in_view import InView
from uav_vslam.config import BackendConfig
from uav_vslam.types import StereoFeatures
from uav_vslam.vision.matching.nn_ratio import match_distances

Pairs = NDArray[np.intp]

SINGLE_CANDIDATE_SIGMAS = 3.0  # per descriptor component: 98 % of correct pairs are nearer, 5 % of wrong ones


def classify(in_view: InView, seen: StereoFeatures, config: BackendConfig) -> Pairs:
    """Match mutual nearest pairs of feature and class that pass the ratio test."""
    return _nearest(squared_mahalanobis(in_view.statistics, seen.descriptors), seen, config)


def classify_gated(in_view: InView, seen: StereoFeatures, config: BackendConfig) -> Pairs:
    """Match as `classify` does, among features inside a landmark's gate."""
    allowed = gate(in_view.expected, in_view.S, seen.pixels.astype(float), probability=config.gate_probability)
    distance2 = squared_mahalanobis(in_view.statistics, seen.descriptors)
    return _nearest(np.where(allowed, distance2, np.float32(np.inf)), seen, config)


def squared_mahalanobis(statistics: DescriptorStatistics, descriptors: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Return the (N, M) squared distances of descriptors from classes, by |d - mu|^2 = d.d - 2 d.mu + mu.mu."""
    if len(statistics.count) == 0 or len(descriptors) == 0:
        return np.zeros((len(statistics.count), len(descriptors)), np.float32)
    weight, d = 1.0 / statistics.variance(), descriptors.astype(float)
    weighted = weight * statistics.mean
    distance2 = weight @ (d * d).T - 2.0 * weighted @ d.T + np.einsum("nd,nd->n", weighted, statistics.mean)[:, None]
    return np.maximum(distance2, 0.0).astype(np.float32)


def _nearest(distance2: NDArray[np.float32], seen: StereoFeatures, config: BackendConfig) -> Pairs:
    alone = SINGLE_CANDIDATE_SIGMAS * float(np.sqrt(seen.descriptors.shape[1]))
    return match_distances(distance2, config.min_descriptor_ratio, single_distance=alone)
