# SPDX-License-Identifier: Apache-2.0
"""Two-point RANSAC [fischler81] between two gravity-aligned maps: yaw and translation from two matches.

Two matches can both be right only if their horizontal distance and height difference are equal in both maps. This test
leaves few of the K (K - 1) / 2 minimal samples, so that usually all of them are tried.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from uav_vslam.cooperation.common_landmarks import offset_covariances
from uav_vslam.cooperation.point_pairs import PointPairs
from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.rotation import rotation_from_rpy
from uav_vslam.numerics import mahalanobis2

Array = NDArray[np.float64]

GATE = 16.3  # chi-square of a pair, 3 degrees of freedom: 99.9 %
TWO_GATE = float(chdtri(2, 0.001))  # of two pairs' distance and height difference
MAX_YAW_SIGMA = np.deg2rad(10.0)  # two points close to each other do not determine yaw
MAX_HYPOTHESES = 600


@dataclass(frozen=True, slots=True)
class Hypotheses:
    """Transforms of the compatible minimal samples.

    Attributes:
        R, t: (H, 3, 3) and (H, 3) T_own_peer.
        distance2: (H, K) squared Mahalanobis distances of all pairs' residuals.
    """

    R: Array
    t: Array
    distance2: Array

    def __len__(self) -> int:
        return len(self.R)

    @property
    def inliers(self) -> NDArray[np.bool_]:
        """(H, K) pairs inside the gate."""
        return self.distance2 <= GATE

    def best(self) -> Pose:
        """Return the transform of the least sum of squared distances, truncated at the gate."""
        h = int(np.argmin(np.minimum(self.distance2, GATE).sum(axis=1)))  # MSAC [torr00]
        return Pose(self.R[h], self.t[h])


def hypotheses(pairs: PointPairs, *, rng: np.random.Generator) -> Hypotheses:
    """Return the transforms of all compatible samples of two pairs, or of a random subset.

    Args:
        pairs: with relative covariances, see `PointPairs.relative`.
        rng: for the subset, if there are more than MAX_HYPOTHESES.
    """
    i, j = np.triu_indices(len(pairs), 1)
    fits = np.flatnonzero(_compatible(pairs, i, j))
    if len(fits) > MAX_HYPOTHESES:
        fits = np.sort(rng.choice(fits, MAX_HYPOTHESES, replace=False))
    i, j = i[fits], j[fits]
    own, peer = pairs.own[j] - pairs.own[i], pairs.peer[j] - pairs.peer[i]
    yaw = np.arctan2(peer[:, 0] * own[:, 1] - peer[:, 1] * own[:, 0], (peer[:, :2] * own[:, :2]).sum(axis=1))
    R = rotation_from_rpy(np.zeros_like(yaw), np.zeros_like(yaw), yaw)
    centre = 0.5 * (pairs.peer[i] + pairs.peer[j])
    t = 0.5 * (pairs.own[i] + pairs.own[j]) - np.einsum("hab,hb->ha", R, centre)
    residuals = pairs.own - np.einsum("hab,kb->hka", R, pairs.peer) - t[:, None]
    return Hypotheses(R, t, mahalanobis2(residuals, pairs.pair_covariances(R)))


def gated(pairs: PointPairs, T_own_peer: Pose, *, slack_m: float = 0.0) -> NDArray[np.intp]:
    """Return the rows of pairs that fit a transform within their covariances and the transform's sigma `slack_m`."""
    S = pairs.pair_covariances(T_own_peer.R) + slack_m**2 * np.eye(3)
    return np.flatnonzero(mahalanobis2(pairs.residuals(T_own_peer), S) <= GATE)


def _compatible(pairs: PointPairs, i: NDArray[np.intp], j: NDArray[np.intp]) -> NDArray[np.bool_]:
    """Return which samples (i, j) have equal distances and heights, and are far enough apart to determine yaw."""
    own, peer = pairs.own[j] - pairs.own[i], pairs.peer[j] - pairs.peer[i]
    own_m, peer_m = (np.linalg.norm(d[:, :2], axis=1) for d in (own, peer))
    variances = _along(pairs.own_covariance, own, i, j) + _along(pairs.peer_covariance, peer, i, j)
    along, across, up = (variances + 2.0 * pairs.floor_variance).T
    distance2 = (own_m - peer_m) ** 2 / along + (own[:, 2] - peer[:, 2]) ** 2 / up
    return np.asarray((distance2 <= TWO_GATE) & (np.sqrt(across) < MAX_YAW_SIGMA * np.minimum(own_m, peer_m)))


def _along(covariance: Array, offset: Array, i: NDArray[np.intp], j: NDArray[np.intp]) -> Array:
    """Return (M, 3) variances of x_j - x_i along the offset on the ground, across it, and up."""
    length = np.maximum(np.linalg.norm(offset[:, :2], axis=1), np.finfo(float).tiny)
    x, y = offset[:, 0] / length, offset[:, 1] / length
    axes = np.zeros((len(i), 3, 3))
    axes[:, 0, 0], axes[:, 0, 1] = x, y
    axes[:, 1, 0], axes[:, 1, 1] = -y, x
    axes[:, 2, 2] = 1.0
    return np.asarray(np.einsum("mab,mbc,mac->ma", axes, offset_covariances(covariance, i, j), axes))
