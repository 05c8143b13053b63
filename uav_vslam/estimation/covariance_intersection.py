# SPDX-License-Identifier: Apache-2.0
"""Fusion of two estimates whose correlation is partly or wholly unknown.

Split covariance intersection [julier01] splits each covariance into an independent and a dependent share and is
consistent for any correlation of the dependent shares. Special cases: nothing dependent is the Kalman update (addition
of information), all dependent is covariance intersection, Eq. (7.1) of [thesis].

    P1 = P1dep / w + P1ind,  P2 = P2dep / (1 - w) + P2ind,  K = P1 E^T (E P1 E^T + P2)^-1,  P+ = (I - K E) P1
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular
from scipy.optimize import minimize_scalar

from uav_vslam.numerics import cholesky, inverse_spd, log_det_of, symmetrise

Array = NDArray[np.float64]

WEIGHT_BOUNDS = (0.3, 1.0)  # of the own information: a peer never dominates
WEIGHT_SKIP = 0.995  # above it the gain is not worth the fusion
POSITION = slice(0, 3)  # rows of the own state


@dataclass(frozen=True, slots=True)
class Split:
    """A covariance as the sum of a share independent of the other estimate and one that may be correlated with it."""

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


class EstimatePair:
    """Two estimates to be fused: x with a split covariance, and a peer's estimate of E x.

    Products over all of x are computed once; evaluating a weight is then cubic in the peer's size only.
    """

    def __init__(self, own: Split, E: Array, peer: Split) -> None:
        """Precompute for `own` (n, n), `E` (k, n) and `peer` (k, k)."""
        self.own, self.peer = own, peer
        self.cross = Split(own.independent @ E.T, own.dependent @ E.T)
        self.common = Split(symmetrise(E @ self.cross.independent), symmetrise(E @ self.cross.dependent))

    def trace(self, weight: float, rows: slice) -> float:
        """Return the trace of some rows of the fused covariance."""
        _, W = self._whitened(weight, rows)
        own = np.diagonal(self.own.independent)[rows] + np.diagonal(self.own.dependent)[rows] / weight
        return float(own.sum() - np.sum(W**2))

    def log_det(self, weight: float) -> float:
        """Return the log determinant of the fused covariance, |P1| |P2| / |S|."""
        P2 = self.peer.inflated(1.0 - weight)
        P1 = self.own.inflated(weight)
        S = self.common.inflated(weight) + P2
        return float(sum(sign * log_det_of(cholesky(A, "covariance")) for sign, A in ((1, P1), (1, P2), (-1, S))))

    def fused(self, innovation: Array, weight: float, peer_weight: float) -> Fused:
        """Fuse a (k,) innovation, the peer's estimate minus E x."""
        L, W = self._whitened(weight, slice(None), peer_weight)
        K = solve_triangular(L, W, lower=True, trans="T", check_finite=False).T
        P = self.own.inflated(weight) - W.T @ W
        if not self.own.dependent.any() and not self.peer.dependent.any():
            return Fused(K @ innovation, Split(P, np.zeros_like(P)), weight)
        taken = K @ self.cross.independent.T
        given = K @ (self.common.independent + self.peer.independent) @ K.T
        independent = symmetrise(self.own.independent - taken - taken.T + given)
        return Fused(K @ innovation, Split(independent, symmetrise(P - independent)), weight)

    def _whitened(self, weight: float, rows: slice, peer_weight: float | None = None) -> tuple[Array, Array]:
        """Return the factor L of S, and L^-1 E P1 for some rows of x."""
        peer = self.peer.inflated(1.0 - weight if peer_weight is None else peer_weight)
        L = cholesky(symmetrise(self.common.inflated(weight) + peer), "innovation covariance of a fusion")
        cross = self.cross.independent[rows] + self.cross.dependent[rows] / weight
        return L, solve_triangular(L, cross.T, lower=True, check_finite=False)


def minimising_weight(cost: Callable[[float], float]) -> float:
    """Return the weight of minimum cost; the cost is convex."""
    bounds = (WEIGHT_BOUNDS[0], WEIGHT_BOUNDS[1] - 1e-6)
    return float(minimize_scalar(cost, bounds=bounds, method="bounded", options={"xatol": 1e-3}).x)


def niehsen(pair: EstimatePair) -> float:
    """Return tr P2 / (tr P1 + tr P2) over the common part [niehsen02]."""
    own, peer = np.trace(pair.common.total), np.trace(pair.peer.total)
    return float(np.clip(peer / (own + peer), *WEIGHT_BOUNDS))


def franken_hupper(pair: EstimatePair) -> float:
    """Return (|Y1 + Y2| - |Y2| + |Y1|) / (2 |Y1 + Y2|) over the common part [franken05].

    In many dimensions |Y1 + Y2| dominates, and the weight tends to 1/2 for any estimates.
    """
    P1 = cholesky(pair.common.total, "own covariance of the common part")
    P2 = cholesky(pair.peer.total, "covariance of a peer")
    both = cholesky(symmetrise(pair.common.total + pair.peer.total), "innovation covariance of a fusion")
    log_sum = log_det_of(both) - log_det_of(P1) - log_det_of(P2)  # |Y1 + Y2| = |P1 + P2| / (|P1| |P2|)
    own, peer = np.exp(-log_det_of(P1) - log_sum), np.exp(-log_det_of(P2) - log_sum)
    return float(np.clip(0.5 * (1.0 - peer + own), *WEIGHT_BOUNDS))


WEIGHTS: dict[str, Callable[[EstimatePair], float]] = {
    "position_trace": lambda pair: minimising_weight(lambda w: pair.trace(w, POSITION)),
    "trace": lambda pair: minimising_weight(lambda w: pair.trace(w, slice(None))),
    "determinant": lambda pair: minimising_weight(pair.log_det),  # over a whole map it always ends at 1
    "niehsen": niehsen,
    "franken_hupper": franken_hupper,
}


def split_covariance_intersection(
    own: Split,
    E: Array,
    innovation: Array,
    peer: Split,
    *,
    weigh: Callable[[EstimatePair], float] = WEIGHTS["position_trace"],
) -> Fused:
    """Fuse a peer's estimate of E x into an own estimate of x; consistent for any correlation of the dependent shares.

    Args:
        own: (n, n) covariance of x.
        E: (k, n) selection of what the peer estimates.
        innovation: (k,) the peer's estimate minus E x.
        peer: (k, k) covariance of the peer's estimate.
        weigh: criterion for the weight of the own information.
    """
    pair = EstimatePair(own, E, peer)
    if not own.dependent.any() or not peer.dependent.any():
        return pair.fused(innovation, 1.0, 1.0)  # independent: both have full weight
    weight = weigh(pair)
    if weight > WEIGHT_SKIP:
        return Fused(np.zeros(len(own.independent)), own, 1.0)
    return pair.fused(innovation, weight, 1.0 - weight)


def inverse_covariance_intersection(own: Array, E: Array, innovation: Array, peer: Array) -> Fused:
    """Fuse by inverse covariance intersection [noack17], tighter than covariance intersection.

    Consistent if the estimates are correlated only through common information, not if their noise is correlated
    otherwise. The rest of x is updated through its covariance with E x.

    Args:
        own: (n, n) covariance of x.
        E: (k, n) selection of what the peer estimates.
        innovation: (k,) the peer's estimate minus E x.
        peer: (k, k) covariance of the peer's estimate.
    """
    cross = own @ E.T
    A, B = symmetrise(E @ cross), peer
    A_inv, B_inv = inverse_spd(A, "own covariance of the common part"), inverse_spd(B, "covariance of a peer")

    def fused(weight: float) -> tuple[Array, Array]:
        common_inv = inverse_spd((1.0 - weight) * A + weight * B, "common information")
        P = inverse_spd(symmetrise(A_inv + B_inv - common_inv), "fused information")
        return P, P @ (B_inv - weight * common_inv)

    weight = minimising_weight(lambda w: float(np.trace(fused(w)[0])))
    P_common, gain = fused(weight)
    K = cross @ A_inv
    P = symmetrise(own - K @ (A - P_common) @ K.T)
    return Fused(K @ (gain @ innovation), Split(np.zeros_like(P), P), weight)
