# SPDX-License-Identifier: Apache-2.0
"""Apply a fused correction to a pose and its landmarks, and propagate the fused pose by the own motion afterwards."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from uav_vslam.cooperation.unknown_frame import FrameEstimate
from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.rotation import skew, so3_exp, so3_left_jacobian
from uav_vslam.numerics import symmetrise
from uav_vslam.types import PoseEstimate

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class FusedEpoch:
    """The own belief after fusion with the peers' packets.

    Attributes:
        own: own-only pose at the epoch.
        pose: fused pose.
        ids, positions: (N,) and (N, 3) fused landmarks [m].
        covariance: (6+3N, 6+3N) of position, rotation and landmarks.
        weight: smallest weight of the own information; 1 if all packets were independent.
        common: number of common landmarks used, by peer.
        matched_ids: own landmarks that some peer shares.
        sources: "vehicle/session" whose measurements are fused.
        frames: estimated frames of peers without a common origin.
        map_landmarks: landmarks shared with the loaded map.
    """

    own: PoseEstimate
    pose: PoseEstimate
    ids: NDArray[np.uint32]
    positions: Array
    covariance: Array
    weight: float
    common: dict[str, int]
    matched_ids: frozenset[int]
    sources: frozenset[str]
    frames: dict[str, FrameEstimate]
    map_landmarks: int = 0


def move(T_map_body: Pose, landmarks: Array, delta: Array) -> tuple[Pose, Array]:
    """Apply a correction (6 + 3N,) of position, xi and landmarks: the exponential of `ri15` without velocity."""
    xi = delta[3:6]
    R_xi, J = so3_exp(xi), so3_left_jacobian(xi)
    arm = landmarks - T_map_body.t
    shift = delta[6:].reshape(-1, 3) + np.cross(arm, xi)
    return Pose(R_xi @ T_map_body.R, T_map_body.t + J @ delta[:3]), T_map_body.t + arm @ R_xi.T + shift @ J.T


def propagated(own: PoseEstimate, fused: PoseEstimate, now: PoseEstimate) -> PoseEstimate:
    """Propagate a fused pose by the own-only motion since its epoch.

    The covariance moves with it and grows by as much as the own covariance grew over the same motion.

    Args:
        own, fused: both poses at the epoch.
        now: the own pose later.
    """
    turn = fused.T_map_body.R @ own.T_map_body.R.T
    moved = now.T_map_body.t - own.T_map_body.t
    pose = Pose(turn @ now.T_map_body.R, fused.T_map_body.t + turn @ moved)
    growth = now.covariance - _transported(own.covariance, moved)
    values, vectors = np.linalg.eigh(symmetrise(growth))
    growth = (vectors * np.maximum(values, 0.0)) @ vectors.T
    covariance = _transported(fused.covariance, turn @ moved) + growth
    return PoseEstimate(now.stamp_ns, pose, symmetrise(covariance))


def _transported(covariance: Array, moved: Array) -> Array:
    """Move a (6, 6) pose covariance rigidly: dp+ = dp - [moved]x xi."""
    T = np.eye(6)
    T[:3, 3:] = -skew(moved)
    return np.asarray(T @ covariance @ T.T)
