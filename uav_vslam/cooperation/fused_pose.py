# SPDX-License-Identifier: Apache-2.0
"""Apply a fused correction to a pose and its landmarks, and propagate the fused pose by the own motion afterwards."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from uav_vslam.cooperation.unknown_frame import FrameEstimate
from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.rotation import skew, so3_exp, so3_left_jacobian, so3_log
from uav_vslam.numerics import symmetrise
from uav_vslam.types import PoseEstimate

Array = NDArray[np.float64]

ROUNDING = 1e-10  # of a covariance, relative
SAME = 1e-8  # relative difference of two covariances that are taken as equal
LOADED_MAP = "the loaded map"


@dataclass(frozen=True, slots=True)
class FusedEpoch:
    """The own belief after fusion with the peers' packets.

    Attributes:
        own: own-only pose at the epoch.
        pose: fused pose.
        positions: (N, 3) fused landmarks, in the order of the own belief [m].
        covariance: (6+3N, 6+3N) of position, rotation and landmarks.
        weight: smallest weight of the own information; 1 if all packets were independent.
        common: number of common landmarks used, by peer.
        sources: "vehicle/session" whose measurements are fused.
        frames: estimated frames of peers without a common origin.
        map_landmarks: landmarks shared with the loaded map.
        contradicting: peers, or `LOADED_MAP`, whose landmarks contradict the own estimate.
        displaced: peers whose map is displaced against the own one, so that none of its landmarks is used.
    """

    own: PoseEstimate
    pose: PoseEstimate
    positions: Array
    covariance: Array
    weight: float
    common: dict[str, int]
    sources: frozenset[str]
    frames: dict[str, FrameEstimate]
    map_landmarks: int = 0
    contradicting: frozenset[str] = frozenset()
    displaced: frozenset[str] = frozenset()


def move(T_map_body: Pose, landmarks: Array, delta: Array) -> tuple[Pose, Array]:
    """Apply a correction (6 + 3N,) of position, xi and landmarks: the exponential of `ri15` without velocity."""
    xi = delta[3:6]
    R_xi, J = so3_exp(xi), so3_left_jacobian(xi)
    arm = landmarks - T_map_body.t
    shift = delta[6:].reshape(-1, 3) + np.cross(arm, xi)
    return Pose(R_xi @ T_map_body.R, T_map_body.t + J @ delta[:3]), T_map_body.t + arm @ R_xi.T + shift @ J.T


def propagated(own: PoseEstimate, fused: PoseEstimate, now: PoseEstimate) -> PoseEstimate:
    """Propagate a fused pose by the own-only motion since, which includes the own filter's corrections.

    The own error becomes e_now = A e + n. The same corrections, applied to the fused pose, x_fused = x_now +
    A (fused - own), leave the error A e_fused + n: P_fused,now = P_now - A (P - P_fused) A^T, whatever the correlation
    of e and e_fused. A is not known here; it is taken as 1 where the own covariance has grown, as process noise does,
    and as the ratio of both covariances where it has shrunk, as a correction without process noise does. Where both
    balance, as in a hover, that claims too much until the next epoch.

    Args:
        own, fused: both poses at the same stamp.
        now: the own pose later.
    """
    turn = fused.T_map_body.R @ own.T_map_body.R.T
    moved = now.T_map_body.t - own.T_map_body.t
    pose = Pose(turn @ now.T_map_body.R, fused.T_map_body.t + turn @ moved)
    before, carried = _transported(own.covariance, moved), _transported(fused.covariance, turn @ moved)
    difference, A = carried - before, _kept(before, now.covariance)
    if A is not None:
        difference, pose = A @ difference @ A.T, _between(now.T_map_body, pose, A)
    return PoseEstimate(now.stamp_ns, pose, symmetrise(now.covariance + difference))


def _kept(before: Array, after: Array) -> Array | None:
    """Return A (6, 6), by which an error of one covariance enters a later one of another; None if it does as it is."""
    floor = np.diag(ROUNDING * np.diagonal(before + after) + np.finfo(float).tiny)  # a start may have no error
    L = np.linalg.cholesky(before + floor)
    half = solve_triangular(L, after + floor, lower=True)
    ratios, V = np.linalg.eigh(symmetrise(solve_triangular(L, half.T, lower=True)))
    shares = np.where(ratios > 1.0 - SAME, 1.0, np.maximum(ratios, 0.0))
    if (shares == 1.0).all():
        return None
    return np.asarray(L @ (V * shares) @ V.T @ solve_triangular(L, np.eye(len(L)), lower=True))


def _between(own: Pose, fused: Pose, A: Array) -> Pose:
    """Return the pose whose error relative to the own one is A times that of the fused pose."""
    xi = so3_log(fused.R @ own.R.T)
    offset = np.concatenate([np.linalg.solve(so3_left_jacobian(xi), fused.t - own.t), xi])
    return move(own, np.zeros((0, 3)), A @ offset)[0]


def _transported(covariance: Array, moved: Array) -> Array:
    """Move a (6, 6) pose covariance rigidly: dp+ = dp - [moved]x xi."""
    T = np.eye(6)
    T[:3, 3:] = -skew(moved)
    return np.asarray(T @ covariance @ T.T)
