# SPDX-License-Identifier: Apache-2.0
"""Fusing peers' packets into a copy of the own belief, at fixed epochs; nothing is ever written back.

At each epoch the own joint belief is taken afresh and every peer's newest packet is fused into it by split covariance
intersection. A packet whose sources and prior are disjoint from everything fused so far is independent and simply
adds; any overlap makes its share dependent. In between, the fused pose is carried by the own-only motion.
"""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from uav_vslam.config import FusionConfig
from uav_vslam.cooperation.authentication import authentication_for
from uav_vslam.cooperation.common_landmarks import comparable
from uav_vslam.cooperation.fused_pose import FusedEpoch, carried, move
from uav_vslam.cooperation.inbox import Inbox
from uav_vslam.cooperation.memory import LandmarkMemory
from uav_vslam.cooperation.peer_frame import CommonFrame, PeerFrame, UnknownFrame
from uav_vslam.cooperation.schemes import SCHEMES, Evidence
from uav_vslam.estimation.covariance_intersection import Split
from uav_vslam.estimation.numerics import inverse_spd
from uav_vslam.slam.packet import POSE_DIM, make_packet, packet_policy
from uav_vslam.types import NS_PER_S, JointInformation, LandmarkPacket, PoseEstimate

Array = NDArray[np.float64]


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
        self._frames: dict[str, PeerFrame] = {}
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
        weight, common, matched, frames = 1.0, {}, set(), {}
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
            frames[peer] = self.frame(peer).settled(fused)
            belief = fused.P
            T_map_body, positions = move(T_map_body, positions, fused.delta)
            weight = min(weight, fused.weight)
            sources |= set(packet.sources)
            priors |= {packet.prior_id} - {""}
        self._shared |= matched
        fused_pose = PoseEstimate(joint.stamp_ns, T_map_body, belief.total[:POSE_DIM, :POSE_DIM])
        known = {peer: frame for peer, frame in frames.items() if frame is not None}
        self.epoch = FusedEpoch(own_pose, fused_pose, joint.ids, positions, weight, common, frozenset(matched), known)
        return self.epoch

    def frame(self, peer: str) -> PeerFrame:
        """Return how a peer's map lies to ours."""
        if peer not in self._frames:
            self._frames[peer] = (CommonFrame if self._config.common_origin else UnknownFrame)(self._config)
        return self._frames[peer]

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
        return self.frame(packet.vehicle).find_common(positions, covariance, joint.descriptors, packet)

    def _evidence(
        self, positions: Array, packet: LandmarkPacket, pairs: NDArray[np.intp], *, dependent: bool
    ) -> Evidence:
        return self.frame(packet.vehicle).evidence(positions, packet, pairs, dependent=dependent)

    def _note(self, peer: str, packet: LandmarkPacket, common: int) -> None:
        record = self.inbox.peers[peer]
        record.common_landmarks = common
        if common:
            record.used.add((packet.session, packet.sequence))
