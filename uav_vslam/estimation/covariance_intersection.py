# SPDX-License-Identifier: Apache-2.0
"""Fusing two estimates whose correlation is partly or wholly unknown.

Split covariance intersection [julier01] writes each covariance as an independent and a dependent share and is
consistent whatever the correlation of the dependent shares. Its corners: nothing dependent is the Kalman update (plain
addition of information), all dependent is covariance intersection, Eq. (7.1) of [thesis].
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from uav_vslam.estimation.numerics import solve_spd, symmetrise

Array = NDArray[np.float64]

WEIGHT_BOUNDS = (0.3, 1.0)  # of the own information: a peer never takes over
WEIGHT_SKIP = 0.995  # a weight above it is no gain worth the fusion


@dataclass(frozen=True, slots=True)
class Split:
    """A covariance as the sum of a share independent of the other side's and one that may be correlated with it."""

    independent: Array
    dependent: Array

    @property
    def total(self) -> Array:
        """The whole covariance."""
        return self.independent + self.dependent

    def inflated(self, weight: float) -> Array:
        """Return independent + dependent / weight."""
        return self.independent + self.dependent / weight


@dataclass(frozen=True, slots=True)
class Fused:
    """Result of a fusion: correction of the mean, new split covariance, and the weight of the own information."""

    delta: Array
    P: Split
    weight: float


def split_covariance_intersection(
    own: Split,
    E: Array,
    innovation: Array,
    peer: Split,
    *,
    cost: Callable[[Array], float],
    weight: float | None = None,
) -> Fused:
    """Fuse a peer's estimate of E x into an own estimate of x.

    P1 = P1dep/w + P1ind, P2 = P2dep/(1-w) + P2ind, K = P1 E^T (E P1 E^T + P2)^-1, P+ = (I - K E) P1.

    Args:
        own: (n, n) covariance of x.
        E: (k, n) selection of what the peer estimates.
        innovation: (k,) the peer's estimate minus E x.
        peer: (k, k) covariance of the peer's estimate.
        cost: what the weight minimises, as a function of the fused covariance.
        weight: fixed weight of the own information instead of a search over WEIGHT_BOUNDS.
    """
    if not own.dependent.any() or not peer.dependent.any():
        return _fuse(own, E, innovation, peer, 1.0, 1.0)  # nothing in common: both count in full
    if weight is None:
        found = minimize_scalar(
            lambda w: cost(_fuse(own, E, innovation, peer, w, 1.0 - w).P.total),
            bounds=(WEIGHT_BOUNDS[0], WEIGHT_BOUNDS[1] - 1e-6),
            method="bounded",
            options={"xatol": 1e-3},
        )
        weight = float(found.x)
    if weight > WEIGHT_SKIP:
        return Fused(np.zeros(len(own.independent)), own, 1.0)
    return _fuse(own, E, innovation, peer, weight, 1.0 - weight)


def _fuse(own: Split, E: Array, innovation: Array, peer: Split, own_weight: float, peer_weight: float) -> Fused:
    P1, P2 = own.inflated(own_weight), peer.inflated(peer_weight)
    S = symmetrise(E @ P1 @ E.T + P2)
    K = solve_spd(S, E @ P1, "innovation of a fusion").T
    A = np.eye(len(P1)) - K @ E
    P = symmetrise(A @ P1)
    independent = symmetrise(A @ own.independent @ A.T + K @ peer.independent @ K.T)
    return Fused(K @ innovation, Split(independent, symmetrise(P - independent)), own_weight)
