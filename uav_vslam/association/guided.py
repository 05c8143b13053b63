# SPDX-License-Identifier: Apache-2.0
"""Geometry first: a feature may match a landmark only inside the chi-square gate of its predicted observation."""

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from uav_vslam.association.in_view import InView
from uav_vslam.config import BackendConfig
from uav_vslam.geometry.stereo import STEREO_DOF
from uav_vslam.types import StereoFeatures
from uav_vslam.vision.matching.nn_ratio import match_gated

Array = NDArray[np.float64]


def gate(predicted: Array, S: Array, observed: Array, *, probability: float) -> NDArray[np.bool_]:
    """Return which observations are inside which landmark's gate.

    Args:
        predicted: (N, 4) predicted stereo pixels.
        S: (N, 4, 4) innovation covariances [px^2].
        observed: (M, 4) stereo pixels.
        probability: that a correct match passes.

    Returns:
        (N, M) mask.
    """
    if len(predicted) == 0 or len(observed) == 0:
        return np.zeros((len(predicted), len(observed)), bool)
    limit = chdtri(STEREO_DOF, 1.0 - probability)
    half_width = np.sqrt(limit * S[:, 0, 0])
    inside = np.abs(observed[:, 0] - predicted[:, :1]) <= half_width[:, None]  # most are far outside already
    rows, columns = np.nonzero(inside)
    whitening = np.linalg.inv(np.linalg.cholesky(S))
    nu = np.einsum("nij,nj->ni", whitening[rows], observed[columns] - predicted[rows])
    inside[rows, columns] = np.einsum("ni,ni->n", nu, nu) <= limit
    return inside


def gated(in_view: InView, seen: StereoFeatures, config: BackendConfig) -> NDArray[np.intp]:
    """Match the nearest descriptors with ratio test and mutual check, among features inside a landmark's gate."""
    allowed = gate(in_view.expected, in_view.S, seen.pixels.astype(float), probability=config.gate_probability)
    return match_gated(in_view.descriptors, seen.descriptors, allowed, config.min_descriptor_ratio)
