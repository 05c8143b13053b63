# SPDX-License-Identifier: Apache-2.0
"""Fusion of a packet in an unknown map frame: the frame is estimated jointly, with a flat prior.

The alignment is computed from the same landmarks that are to be fused. Taken as known it would count them twice, so it
is the linearisation point only, and T_own_peer is a state with a flat prior. With the true
l_own = T_own_peer l_peer and T's error dT (4,),

    r = T^ l^_peer - l^_own = E dx - A dT + e,   e ~ R.

A state with a flat prior can be eliminated: with N an orthonormal basis of the left null space of A, N^T A = 0,

    N^T r = N^T E dx + N^T e

holds all information of r about x, in every scheme. Afterwards dT = G dx - C A^T R^-1 r with covariance C + G P+ G^T,
where C = (A^T R^-1 A)^-1 and G = C A^T R^-1 E. So a peer contributes the shape of its map, not its pose.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from uav_vslam.cooperation.point_pairs import FRAME_DIM, corrected, frame_jacobian, rotated
from uav_vslam.cooperation.schemes import Evidence
from uav_vslam.estimation.belief import landmark_rows
from uav_vslam.estimation.covariance_intersection import Fused
from uav_vslam.geometry.pose import Pose
from uav_vslam.numerics import inverse_spd, submatrix, symmetrise
from uav_vslam.types import LandmarkPacket

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class FrameEstimate:
    """A peer's map frame in ours after a fusion: for publication, never a prior of the next fusion.

    Attributes:
        T_own_peer: rotation about the vertical and translation.
        covariance: (4, 4) of translation [m^2] and yaw [rad^2], as `point_pairs` orders its error.
    """

    T_own_peer: Pose
    covariance: Array


@dataclass(frozen=True, slots=True)
class UnknownFramePacket:
    """A packet in an unknown frame.

    Attributes:
        evidence: on the own state, with the frame eliminated.
        T_own_peer: linearisation point.
        A: (3K, 4), whole: evidence on state and frame together, before the elimination.
    """

    evidence: Evidence
    T_own_peer: Pose
    A: Array
    whole: Evidence

    def frame(self, fused: Fused) -> FrameEstimate:
        """Return the frame after `evidence` was fused."""
        R_inv = inverse_spd(self.whole.R + self.whole.floor, "covariance of a packet")
        C = inverse_spd(symmetrise(self.A.T @ R_inv @ self.A), "a peer's frame")
        gain = C @ self.A.T @ R_inv
        G = gain @ self.whole.E
        covariance = C + symmetrise(G @ fused.P.total @ G.T)
        if fused.P.dependent.any():  # unknown correlation of x and e: (a + b)(a + b)^T <= 2 (a a^T + b b^T)
            covariance = 2.0 * covariance
        return FrameEstimate(corrected(self.T_own_peer, G @ fused.delta - gain @ self.whole.innovation), covariance)


def eliminate_frame(
    positions: Array,
    packet: LandmarkPacket,
    pairs: NDArray[np.intp],
    T_own_peer: Pose,
    *,
    floor_sigma_m: float,
    dependent: bool,
) -> UnknownFramePacket:
    """Express a packet's landmarks in the own frame and eliminate the frame's four degrees of freedom.

    Args:
        positions: (N, 3) own landmarks [m].
        packet: the peer's.
        pairs: (K, 2) rows of own landmarks and of the packet.
        T_own_peer: from an alignment, for linearisation only.
        floor_sigma_m: of each pair: two detections are never of exactly the same point [m].
        dependent: as of `Evidence`.
    """
    peer = packet.positions[pairs[:, 1]]
    whole = Evidence.of_landmarks(
        positions,
        pairs[:, 0],
        T_own_peer.apply(peer),
        rotated(submatrix(packet.covariance, landmark_rows(0, pairs[:, 1])), T_own_peer.R),
        floor_sigma_m=floor_sigma_m,
        dependent=dependent,
    )
    A = frame_jacobian(T_own_peer, peer)
    N = np.linalg.qr(A, mode="complete")[0][:, FRAME_DIM:]
    evidence = Evidence(
        E=N.T @ whole.E,
        innovation=N.T @ whole.innovation,
        R=symmetrise(N.T @ whole.R @ N),
        floor=floor_sigma_m**2 * np.eye(N.shape[1]),
        dependent=dependent,
    )
    return UnknownFramePacket(evidence, T_own_peer, A, whole)
