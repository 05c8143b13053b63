# SPDX-License-Identifier: Apache-2.0
"""Fusing peers' packets into a copy of the own belief, at fixed epochs; nothing is ever written back.

At each epoch the own joint belief is taken afresh and every peer's newest packet is fused into it by split covariance
intersection. A packet whose sources and prior are disjoint from everything fused so far is independent and simply
adds; any overlap makes its share dependent. In between, the fused pose is carried by the own-only motion.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from uav_vslam.config import FusionConfig
from uav_vslam.cooperation.authentication import authentication_for
from uav_vslam.cooperation.common_landmarks import comparable, find_common
from uav_vslam.cooperation.inbox import Inbox
from uav_vslam.cooperation.memory import LandmarkMemory
from uav_vslam.cooperation.schemes import SCHEMES, Evidence
from uav_vslam.estimation.belief import landmark_rows
from uav_vslam.estimation.covariance_intersection import Split
from uav_vslam.estimation.numerics import inverse_spd, symmetrise
from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.rotation import skew, so3_exp, so3_left_jacobian
from uav_vslam.slam.packet import POSE_DIM, make_packet, packet_policy
from uav_vslam.types import NS_PER_S, JointInformation, LandmarkPacket, PoseEstimate

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class FusedEpoch:
    """The own belief improved by peers.

    Attributes:
        own: own-only pose at the epoch.
        pose: fused pose.
        ids, positions: (N,) and (N, 3) fused landmarks [m].
        weight: smallest weight that the own information got; 1 where all was independent.
        common: number of common landmarks used, by peer.
        matched_ids: own landmarks that some peer shares.
    """

    own: PoseEstimate
    pose: PoseEstimate
    ids: NDArray[np.uint32]
    positions: Array
    weight: float
    common: dict[str, int]
    matched_ids: frozenset[int]


class Fusion:
    """The fusion node's core.

    Attributes:
        inbox: what peers sent.
        belief: own belief of the last epoch, with the landmarks that are remembered.
        epoch: what the last fusion made of it.
    """

    def __init__(self, vehicle: str, config: FusionConfig) -> None:
        self._authentication = authentication_for(vehicle, config)
        self.inbox = Inbox(vehicle, authentication=self._authentication)
        self._config = config
        self._memory = LandmarkMemory(config.memory_landmarks)
        self._shared: set[int] = set()
        self._sequence = 0
        self.belief: JointInformation | None = None
        self.epoch: FusedEpoch | None = None

    def packet(self, joint: JointInformation, *, byte_limit: int | None = None) -> LandmarkPacket:
        """Make the next packet from the own-only belief; fused numbers are never sent as own.

        Args:
            joint: the own belief, as it was fused last or newer.
            byte_limit: what the link has room for now.
        """
        if self.belief is not None and self.belief.stamp_ns == joint.stamp_ns:
            joint = self.belief
        self._sequence += 1
        packet = make_packet(
            joint,
            sequence=self._sequence,
            policy=packet_policy(self._config, tag_bytes=self._authentication.tag_bytes),
            matched_ids=self.epoch.matched_ids if self.epoch else (),
            prior_id=self._config.prior_id,
            byte_limit=byte_limit,
        )
        return self._authentication.sign(packet)

    def fuse(self, joint: JointInformation) -> FusedEpoch:
        """Start from the own belief and bring in each peer's newest packet that is old enough."""
        joint = self.belief = self._memory.extended(joint, self._shared)
        P = inverse_spd(joint.information, "own joint information")
        T_map_body, positions = joint.T_map_body, joint.positions
        own_pose = PoseEstimate(joint.stamp_ns, T_map_body, P[:POSE_DIM, :POSE_DIM])
        belief = Split(P, np.zeros_like(P))
        sources, priors = {f"{joint.vehicle}/{joint.session}"}, {self._config.prior_id} - {""}
        weight, common, matched = 1.0, {}, set()
        for peer, packet in self._packets_for(joint):
            pairs = self._common(joint, positions, belief, packet)
            self._note(peer, packet, len(pairs))
            common[peer] = len(pairs)
            matched |= set(joint.ids[pairs[:, 0]].tolist())
            if len(pairs) == 0:
                continue
            dependent = bool(sources & set(packet.sources)) or packet.prior_id in priors
            evidence = self._evidence(positions, packet, pairs, dependent=dependent)
            fused = SCHEMES[self._config.scheme](belief, evidence, self._config.weighing)
            belief = fused.P
            T_map_body, positions = move(T_map_body, positions, fused.delta)
            weight = min(weight, fused.weight)
            sources |= set(packet.sources)
            priors |= {packet.prior_id} - {""}
        self._shared |= matched
        fused_pose = PoseEstimate(joint.stamp_ns, T_map_body, belief.total[:POSE_DIM, :POSE_DIM])
        self.epoch = FusedEpoch(own_pose, fused_pose, joint.ids, positions, weight, common, frozenset(matched))
        return self.epoch

    def carry(self, own: PoseEstimate) -> PoseEstimate:
        """Return the fused pose at a later own-only estimate: the last fused pose moved by the own motion since."""
        if self.epoch is None:
            return own
        return carried(self.epoch, own)

    def _packets_for(self, joint: JointInformation) -> Iterator[tuple[str, LandmarkPacket]]:
        """Yield each peer's newest packet that an epoch may use."""
        not_after_ns = joint.stamp_ns - round(self._config.min_delay_s * NS_PER_S)
        for peer in sorted(self.inbox.peers) if self._config.mode != "none" else ():
            packet = self.inbox.newest(peer, not_after_ns)
            if packet is None:
                continue
            if not comparable(joint.descriptors, packet):
                self.inbox.peers[peer].dropped["descriptor_size"] += 1
                continue
            yield peer, packet

    def _common(
        self, joint: JointInformation, positions: Array, belief: Split, packet: LandmarkPacket
    ) -> NDArray[np.intp]:
        covariance = belief.total[POSE_DIM:, POSE_DIM:]
        return find_common(positions, covariance, joint.descriptors, packet, config=self._config)

    def _evidence(
        self, positions: Array, packet: LandmarkPacket, pairs: NDArray[np.intp], *, dependent: bool
    ) -> Evidence:
        columns, rows = landmark_rows(POSE_DIM, pairs[:, 0]), landmark_rows(0, pairs[:, 1])
        E = np.zeros((len(columns), POSE_DIM + positions.size))
        E[np.arange(len(columns)), columns] = 1.0
        return Evidence(
            E=E,
            innovation=(packet.positions[pairs[:, 1]] - positions[pairs[:, 0]]).ravel(),
            R=packet.covariance[np.ix_(rows, rows)],
            floor=self._config.floor_sigma_m**2 * np.eye(len(rows)),
            dependent=dependent,
        )

    def _note(self, peer: str, packet: LandmarkPacket, common: int) -> None:
        record = self.inbox.peers[peer]
        record.common_landmarks = common
        if common:
            record.used.add((packet.session, packet.sequence))


def move(T_map_body: Pose, landmarks: Array, delta: Array) -> tuple[Pose, Array]:
    """Apply a correction (6 + 3N,) of position, xi and landmarks: the exponential of `ri15` without velocity."""
    xi = delta[3:6]
    R_xi, J = so3_exp(xi), so3_left_jacobian(xi)
    arm = landmarks - T_map_body.t
    shift = delta[6:].reshape(-1, 3) + np.cross(arm, xi)
    return Pose(R_xi @ T_map_body.R, T_map_body.t + J @ delta[:3]), T_map_body.t + arm @ R_xi.T + shift @ J.T


def carried(epoch: FusedEpoch, own: PoseEstimate) -> PoseEstimate:
    """Carry a fused pose along the own-only motion since its epoch.

    The covariance is carried likewise and grows by what the own covariance grew by over the same motion.
    """
    turn = epoch.pose.T_map_body.R @ epoch.own.T_map_body.R.T
    moved = own.T_map_body.t - epoch.own.T_map_body.t
    pose = Pose(turn @ own.T_map_body.R, epoch.pose.T_map_body.t + turn @ moved)
    growth = own.covariance - _transported(epoch.own.covariance, moved)
    values, vectors = np.linalg.eigh(symmetrise(growth))
    growth = (vectors * np.maximum(values, 0.0)) @ vectors.T
    covariance = _transported(epoch.pose.covariance, turn @ moved) + growth
    return PoseEstimate(own.stamp_ns, pose, symmetrise(covariance))


def _transported(covariance: Array, moved: Array) -> Array:
    """Move a (6, 6) pose covariance rigidly: dp+ = dp - [moved]x xi."""
    T = np.eye(6)
    T[:3, 3:] = -skew(moved)
    return np.asarray(T @ covariance @ T.T)
