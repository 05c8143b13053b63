# SPDX-License-Identifier: Apache-2.0
"""Map alignment: T_own_peer from descriptor matches; refused while the evidence is insufficient.

Descriptors alone propose the matches, and on farmland many are wrong. Two-point RANSAC finds the transform with the
most inliers. Its gate uses the relative covariance within each map only: the drift that a map's landmarks share is
part of the transform. A weighted least-squares fit with both joint covariances follows, in which each pair has to be
consistent with the prediction of all others.

Gravity gives both maps the same vertical, so tilt is not estimated: over flat ground it can't be.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from uav_vslam.cooperation.common_landmarks import log_sets, map_area
from uav_vslam.cooperation.data_snooping import predicted_by_others
from uav_vslam.cooperation.point_pairs import (
    FLAT_SIGMA,
    FRAME_DIM,
    YAW,
    PointPairs,
    Rows,
    corrected,
    frame_jacobian,
)
from uav_vslam.cooperation.schemes import FALSE_ALARM
from uav_vslam.cooperation.two_point import GATE, Hypotheses, gated, hypotheses
from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.rotation import so3_log
from uav_vslam.numerics import inverse_spd, mahalanobis2

Array = NDArray[np.float64]

MIN_INLIERS = 8
LOG_CHANCE = np.log(1e-6)  # of wrong matches agreeing like this anywhere: with one try a second, once in ten days
RIVAL_SHARE = 0.5  # a second transform with this share of the best one's inliers makes the best one ambiguous
MAX_SIGMA_YAW = np.deg2rad(2.0)  # from the shape of the inliers alone, see `sigma_yaw`
STEP_SIGMA_M = 1.0  # of a known frame's translation: two maps drift apart by less between packets
REFINE_ROUNDS = 5  # of fitting and gating; two or three suffice
FIT_ROUNDS = 10
CONVERGED = 1e-9  # largest step of a fit [m], [rad]


@dataclass(frozen=True, slots=True)
class Alignment:
    """A peer's map frame in ours.

    Attributes:
        T_own_peer: rotation about the vertical and translation.
        covariance: (4, 4) of translation and yaw, as `point_pairs` orders its error, relative to the true frames: it
            includes both maps' drift.
        inliers: (K,) ascending rows of the pairs used.
    """

    T_own_peer: Pose
    covariance: Array
    inliers: Rows

    @property
    def contradicts_common_frame(self) -> bool:
        """Whether the maps are displaced by more than both can be off if their frames are the same."""
        displacement = np.append(self.T_own_peer.t, so3_log(self.T_own_peer.R)[2])
        return bool(mahalanobis2(displacement, self.covariance) > chdtri(FRAME_DIM, FALSE_ALARM))


@dataclass(frozen=True, slots=True)
class Refusal:
    """Why no alignment was found."""

    reason: str


def align(pairs: PointPairs) -> Alignment | Refusal:
    """Estimate T_own_peer from putative pairs with many outliers."""
    if len(pairs) < MIN_INLIERS:
        return Refusal(f"{len(pairs)} matches, {MIN_INLIERS} needed")
    relative = pairs.relative()
    tried = hypotheses(relative, rng=np.random.default_rng(0))
    if len(tried) == 0:
        return Refusal(f"no two of {len(pairs)} matches agree")
    best = tried.best()
    found = _refined(pairs, relative, best, gated(relative, best))
    agreeing = len(found.inliers) if found else 0
    if found is None or agreeing < MIN_INLIERS:
        return Refusal(f"{agreeing} of {len(pairs)} matches agree, {MIN_INLIERS} needed")
    return _refusal(found, relative, tried) or found


def follow(pairs: PointPairs, T_own_peer: Pose) -> Alignment | None:
    """Refine an approximately known transform with its mutually consistent inliers; None if fewer than two.

    The caller judges their number and how well they determine the transform.
    """
    relative = pairs.relative()
    return _refined(pairs, relative, T_own_peer, gated(relative, T_own_peer, slack_m=STEP_SIGMA_M))


def sigma_yaw(relative: PointPairs, found: Alignment) -> float:
    """Return the sigma of yaw from the inliers' geometry, each pair independent: small if spread out [rad]."""
    inliers = relative.take(found.inliers)
    S = inliers.pair_covariances(found.T_own_peer.R)
    about = inliers.peer.mean(axis=0)  # far from the origin the prior of the translation would be one of yaw
    A = frame_jacobian(found.T_own_peer, inliers.peer - about).reshape(-1, 3, FRAME_DIM)
    Y = np.einsum("kai,kaj->ij", A, np.linalg.solve(S, A))
    return float(np.sqrt(inverse_spd(Y + np.diag(FLAT_SIGMA**-2), "a fit of two maps")[YAW, YAW]))


def _refined(pairs: PointPairs, relative: PointPairs, T_own_peer: Pose, rows: Rows) -> Alignment | None:
    """Reject outliers, fit and gate again, until the inlier set no longer changes."""
    for _ in range(REFINE_ROUNDS):
        inliers = rows[_consistent(pairs.take(rows), T_own_peer)]
        if len(inliers) < 2:
            return None
        T_own_peer, covariance = fit(pairs.take(inliers), T_own_peer)
        before, rows = rows, gated(relative, T_own_peer)
        if np.array_equal(rows, before):
            break
    return Alignment(T_own_peer, covariance, inliers)


def fit(pairs: PointPairs, T_own_peer: Pose) -> tuple[Pose, Array]:
    """Minimise r^T S^-1 r over yaw and translation by Gauss-Newton; return T_own_peer and its (4, 4) covariance.

    Directions that the pairs do not determine stay unchanged, with the sigmas of the flat prior.
    """
    for _ in range(FIT_ROUNDS):
        W, A = _weights(pairs, T_own_peer)
        covariance = inverse_spd(A.T @ W @ A + np.diag(FLAT_SIGMA**-2), "a fit of two maps")
        delta = covariance @ (A.T @ (W @ pairs.residuals(T_own_peer).ravel()))
        T_own_peer = corrected(T_own_peer, delta)
        if np.abs(delta).max() < CONVERGED:
            break
    return T_own_peer, covariance


def _weights(pairs: PointPairs, T_own_peer: Pose) -> tuple[Array, Array]:
    """Return the (3K, 3K) information of the residuals and their (3K, 4) negative derivative by T."""
    W = inverse_spd(pairs.covariance(T_own_peer.R), "covariance of matches between two maps")
    return W, frame_jacobian(T_own_peer, pairs.peer)


def _consistent(pairs: PointPairs, T_own_peer: Pose) -> Rows:
    """Return the rows of the pairs that the others predict.

    With T unknown the residuals' information is B = W - W A (A^T W A)^-1 A^T W.
    """
    W, A = _weights(pairs, T_own_peer)
    B = W - W @ A @ np.linalg.solve(A.T @ W @ A + np.diag(FLAT_SIGMA**-2), A.T @ W)
    return predicted_by_others(B, pairs.residuals(T_own_peer), GATE, least=2)  # two are always consistent


def _refusal(found: Alignment, relative: PointPairs, tried: Hypotheses) -> Refusal | None:
    """Return why an alignment is not to be trusted yet; None if it is."""
    agreeing, count = len(found.inliers), len(relative)
    if log_chance(found, relative) > LOG_CHANCE:
        return Refusal(f"{agreeing} of {count} matches agree, which wrong ones may do by chance")
    yaw = sigma_yaw(relative, found)
    if not yaw < MAX_SIGMA_YAW:
        return Refusal(f"{agreeing} matches are too close together: sigma of yaw {np.rad2deg(yaw):.1f} degrees")
    others = np.delete(tried.inliers, found.inliers, axis=1)
    rival = int(others.sum(axis=1).max(initial=0))
    if rival >= RIVAL_SHARE * agreeing:
        return Refusal(f"ambiguous: {agreeing} matches agree, {rival} others on another transform")
    return None


def log_chance(found: Alignment, relative: PointPairs) -> float:
    """Return the log of the expected number of inlier sets of this size from wrong matches alone, cf. [moisan04].

    A wrong match is uniform over the map, so it fits a transform with p = area of its gate / area of the map: on flat
    ground height does not discriminate. Any two of n matches give a transform, any k - 2 of the others may fit it.
    """
    n, k = len(relative), len(found.inliers)
    whole = map_area(relative.own)
    gates = relative.take(found.inliers).pair_covariances(found.T_own_peer.R)[:, :2, :2]
    area = np.pi * GATE * float(np.sqrt(np.linalg.det(gates)).mean())
    p = min(1.0, area / whole) if whole > 0 else 1.0
    return float(np.log(n * (n - 1) / 2) + log_sets(n - 2, k - 2) + (k - 2) * np.log(p))
