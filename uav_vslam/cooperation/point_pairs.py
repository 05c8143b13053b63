# SPDX-License-Identifier: Apache-2.0
"""Pairs of landmarks of two maps, and the four degrees of freedom between gravity-aligned maps.

T_own_peer is a rotation about the vertical and a translation. Its error is (4,) `[dt, dyaw]`, as everywhere in the own
map frame: t + dt, R_z(dyaw) R. So T_own_peer l moves by dt + dyaw z x (R l).
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from uav_vslam.cooperation.common_landmarks import blocks
from uav_vslam.cooperation.own_landmarks import OwnLandmarks
from uav_vslam.cooperation.received_map import PeerLandmarks
from uav_vslam.estimation.belief import landmark_rows
from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.rotation import rotation_from_rpy
from uav_vslam.numerics import submatrix

Array = NDArray[np.float64]
Rows = NDArray[np.intp]

FRAME_DIM = 4
YAW = 3  # index in the error
MIN_SIGMA_M = 1e-3  # of a pair: relative covariances may be singular
FLAT_SIGMA = np.array([1e3, 1e3, 1e3, np.pi])  # flat prior: far larger than any map [m], [rad]


@dataclass(frozen=True, slots=True)
class PointPairs:
    """Putative matches of landmarks, each map's in its own frame.

    Attributes:
        own, peer: (K, 3) [m].
        own_covariance, peer_covariance: (3K, 3K) joint covariance in each map [m^2].
        floor_sigma_m: of each pair: two detections are never of exactly the same point [m].
    """

    own: Array
    peer: Array
    own_covariance: Array
    peer_covariance: Array
    floor_sigma_m: float

    @staticmethod
    def of(own: OwnLandmarks, packet: PeerLandmarks, pairs: Rows, floor_sigma_m: float) -> "PointPairs":
        """Select (K, 2) rows of own landmarks and of a packet's."""
        return PointPairs(
            own.positions[pairs[:, 0]],
            packet.positions[pairs[:, 1]],
            submatrix(own.covariance, landmark_rows(0, pairs[:, 0])),
            submatrix(packet.covariance, landmark_rows(0, pairs[:, 1])),
            floor_sigma_m,
        )

    def __len__(self) -> int:
        return len(self.own)

    @property
    def floor_variance(self) -> float:
        """Independent variance of each coordinate of each pair [m^2]."""
        return max(self.floor_sigma_m, MIN_SIGMA_M) ** 2

    def take(self, rows: Rows) -> "PointPairs":
        """Return some of the pairs."""
        k = landmark_rows(0, rows)
        return PointPairs(
            self.own[rows],
            self.peer[rows],
            submatrix(self.own_covariance, k),
            submatrix(self.peer_covariance, k),
            self.floor_sigma_m,
        )

    def residuals(self, T_own_peer: Pose) -> Array:
        """Return (K, 3) own landmarks minus the peer's in the own frame [m]."""
        return self.own - T_own_peer.apply(self.peer)

    def covariance(self, R_own_peer: Array) -> Array:
        """Return the (3K, 3K) joint covariance of the residuals."""
        floor = self.floor_variance * np.eye(3 * len(self))
        return self.own_covariance + rotated(self.peer_covariance, R_own_peer) + floor

    def pair_covariances(self, R_own_peer: Array) -> Array:
        """Return the (..., K, 3, 3) covariances of each pair's residual, for (..., 3, 3) rotations."""
        k = np.arange(len(self))
        own, peer = blocks(self.own_covariance)[k, k], blocks(self.peer_covariance)[k, k]
        turned_peer = np.einsum("...ab,kbc,...dc->...kad", R_own_peer, peer, R_own_peer)
        return np.asarray(own + turned_peer + self.floor_variance * np.eye(3))

    def relative(self) -> "PointPairs":
        """Return the pairs with relative covariances: each map's common translation and yaw removed."""
        own, peer = _inner(self.own_covariance, self.own), _inner(self.peer_covariance, self.peer)
        return replace(self, own_covariance=own, peer_covariance=peer)


def rotated(covariance: Array, R: Array) -> Array:
    """Return a (3K, 3K) covariance of points in another frame: each 3 x 3 block B becomes R B R^T."""
    n = len(covariance) // 3
    return np.asarray(np.einsum("ab,ibjc,dc->iajd", R, covariance.reshape(n, 3, n, 3), R).reshape(3 * n, 3 * n))


def frame_jacobian(T_own_peer: Pose, peer: Array) -> Array:
    """Return the (3K, 4) derivative of T_own_peer l with respect to T's error, for (K, 3) points."""
    arm = peer @ T_own_peer.R.T
    J = np.zeros((len(peer), 3, FRAME_DIM))
    J[:, :, :3] = np.eye(3)
    J[:, 0, YAW], J[:, 1, YAW] = -arm[:, 1], arm[:, 0]
    return J.reshape(-1, FRAME_DIM)


def corrected(T_own_peer: Pose, delta: Array) -> Pose:
    """Apply a correction (4,); tilt stays unchanged."""
    return Pose(rotation_from_rpy(0.0, 0.0, delta[YAW]) @ T_own_peer.R, T_own_peer.t + delta[:3])


def _inner(covariance: Array, points: Array) -> Array:
    """Return M P M^T, M = I - A A^+: the inner covariance of a free network with the four gauge directions A."""
    if len(points) == 0:
        return covariance
    A = frame_jacobian(Pose.identity(), points - points.mean(axis=0))
    M = np.eye(len(A)) - A @ np.linalg.pinv(A)
    return np.asarray(M @ covariance @ M)
