# SPDX-License-Identifier: Apache-2.0
"""Fusing peers' packets into a copy of the own belief, at fixed epochs; nothing is ever written back.

At each epoch the own joint belief is taken afresh and every peer's newest packet is fused into it by split covariance
intersection. A packet whose sources and prior are disjoint from everything fused so far is independent and simply
adds; any overlap makes its share dependent. In between, the own-only motion propagates the fused pose.
"""

import dataclasses
from collections import Counter
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from uav_vslam.config import FusionConfig
from uav_vslam.cooperation.authentication import authentication_for
from uav_vslam.cooperation.common_landmarks import comparable
from uav_vslam.cooperation.epoch_fusion import EpochFusion
from uav_vslam.cooperation.fused_pose import FusedEpoch, propagated
from uav_vslam.cooperation.inbox import Inbox
from uav_vslam.cooperation.memory import LandmarkMemory
from uav_vslam.cooperation.peer_frame import CommonFrame, PeerFrame, UnknownFrame
from uav_vslam.estimation.belief import state_rows
from uav_vslam.numerics import inverse_spd, submatrix
from uav_vslam.slam.packet import ANCHOR, POSE_DIM, PacketPolicy, checksum, make_packet, packet_policy
from uav_vslam.types import NS_PER_S, JointInformation, LandmarkPacket, PoseEstimate

Pairs = NDArray[np.intp]

MIN_DELAY_S = 0.2  # only packets this much older than the epoch are fused, so that a replay repeats exactly
ENOUGH_SHARED = 5  # landmarks in common that make a newer packet worth more than an older one with more of them
FEEDBACK = PacketPolicy(form=ANCHOR, max_landmarks=20)  # a few say it all, and bounding many by one error takes long


class Fusion:
    """The fusion node's core.

    Attributes:
        vehicle: whose it is.
        inbox: what peers sent.
        returned: what peers' fusions made of the own landmarks: their feedback.
        belief: own belief of the last epoch, with the landmarks that are remembered.
        epoch: what the last fusion made of it.
    """

    def __init__(self, vehicle: str, config: FusionConfig) -> None:
        self.vehicle = vehicle
        self._authentication = authentication_for(vehicle, config)
        self.inbox = Inbox(vehicle, authentication=self._authentication)
        self.returned = Inbox(vehicle, authentication=self._authentication)
        self._config = config
        self._memory = LandmarkMemory(config.memory_landmarks)
        self._frames: dict[str, PeerFrame] = {}
        self._used: dict[str, LandmarkPacket] = {}
        self._shared: set[int] = set()
        self._offered: set[int] = set()  # landmarks of the last packet, where no feedback tells what became of them
        self._times_sent: Counter[int] = Counter()  # how often each landmark of the estimate was sent
        self._sequence = 0
        self._told: dict[str, tuple[str, NDArray[np.intp], NDArray[np.uint32]]] = {}  # its source, own rows, its ids
        self.belief: JointInformation | None = None
        self.epoch: FusedEpoch | None = None

    def configure(self, config: FusionConfig) -> None:
        """Go on with other settings, as another communication mode has them."""
        self._config = config

    def packet(self, *, byte_limit: int | None = None) -> LandmarkPacket:
        """Make the next packet from the own belief of the last epoch; fused numbers are never sent as own.

        Args:
            byte_limit: what the link has room for now.
        """
        assert self.belief is not None  # an epoch has been fused
        self._sequence += 1
        packet = make_packet(
            self.belief,
            sequence=self._sequence,
            policy=packet_policy(self._config, tag_bytes=self._authentication.tag_bytes),
            matched_ids=self._shared,
            times_sent=self._times_sent,
            prior_id=self._config.prior_id,
            byte_limit=byte_limit,
        )
        self._times_sent = Counter({i: self._times_sent[i] for i in self.belief.ids.tolist()})
        self._times_sent.update(packet.ids.tolist())
        self._offered = set() if self._config.returns_feedback else set(packet.ids.tolist())
        return self._authentication.sign(packet)

    def feedback(self, peer: str) -> LandmarkPacket | None:
        """Return the last fused estimates of the landmarks that a peer reported, by the peer's identifiers.

        The peer's measurements are inside, so that its fusion intersects with it; what others told may be inside too.
        """
        told = self._told.get(peer)
        if self.belief is None or self.epoch is None or told is None:
            return None
        addressee, rows, ids = told
        columns = state_rows(POSE_DIM, rows)
        fused = JointInformation(
            stamp_ns=self.belief.stamp_ns,
            vehicle=self.belief.vehicle,
            session=self.belief.session,
            T_map_body=self.epoch.pose.T_map_body,
            ids=ids,
            positions=self.epoch.positions[rows],
            information=inverse_spd(submatrix(self.epoch.covariance, columns), "fused landmarks"),
            descriptors=np.zeros((len(ids), 0), np.uint8),
        )
        packet = make_packet(fused, sequence=self._sequence, policy=FEEDBACK, matched_ids=ids.tolist())
        others = sorted(self.epoch.sources - {packet.source, addressee})
        packet = dataclasses.replace(packet, sources=(packet.source, addressee, *others))
        return self._authentication.sign(dataclasses.replace(packet, checksum=checksum(packet)))

    def fuse(self, joint: JointInformation) -> FusedEpoch:
        """Start from the own belief and bring in each peer's newest packet, and feedback, that is old enough."""
        if self.belief is not None and joint.session != self.belief.session:  # its landmark numbers are new
            self._shared, self._offered, self._times_sent = set(), set(), Counter()
        self.belief = self._memory.extended(joint, self._shared, self._offered)
        config = self._config
        fusing = EpochFusion(self.belief, scheme=config.scheme, weighing=config.weighing, prior_id=config.prior_id)
        self._told.clear()
        for peer, newest in self._newest(self.inbox):
            if not comparable(joint.descriptors, newest):
                self.inbox.peers[peer].dropped["descriptor_size"] += 1
                continue
            packet, pairs = self._chosen(fusing, newest)
            self._note(peer, packet, len(pairs))
            fusing.common[peer] = len(pairs)
            fusing.add(packet, pairs, self.frame(peer))
            if len(pairs):
                self._told[peer] = packet.source, pairs[:, 0], packet.ids[pairs[:, 1]]
        for peer, packet in self._newest(self.returned):
            fusing.add(packet, self._named(fusing, packet), self.frame(peer))
        self._shared = self._shared & set(self.belief.ids.tolist()) | fusing.matched
        self.epoch = fusing.epoch()
        return self.epoch

    def frame(self, peer: str) -> PeerFrame:
        """Return how a peer's map lies to ours."""
        if peer not in self._frames:
            self._frames[peer] = (CommonFrame if self._config.common_origin else UnknownFrame)(self._config)
        return self._frames[peer]

    def propagate(self, own: PoseEstimate) -> PoseEstimate:
        """Return the last fused pose, propagated by the own-only motion since its epoch."""
        if self.epoch is None:
            return own
        return propagated(self.epoch.own, self.epoch.pose, own)

    def _newest(self, inbox: Inbox) -> Iterator[tuple[str, LandmarkPacket]]:
        """Yield each peer's newest packet that this epoch may use."""
        assert self.belief is not None
        not_after_ns = self.belief.stamp_ns - round(MIN_DELAY_S * NS_PER_S)
        for peer in sorted(inbox.peers) if self._config.mode != "none" else ():
            packet = inbox.newest(peer, not_after_ns)
            if packet is not None:
                yield peer, packet

    def _chosen(self, fusing: EpochFusion, newest: LandmarkPacket) -> tuple[LandmarkPacket, Pairs]:
        """Return the one packet of a peer that is used: the newest, or the one of last time if only that shares enough.

        Not while a frame has to be found: that takes every packet once, in order.
        """
        pairs, last = self._common(fusing, newest), self._used.get(newest.vehicle)
        another = last is not None and last is not newest and last.session == newest.session
        if last is not None and another and len(pairs) < ENOUGH_SHARED and self._config.common_origin:
            before = self._common(fusing, last)
            if len(before) > len(pairs):
                return last, before
        self._used[newest.vehicle] = newest
        return newest, pairs

    def _common(self, fusing: EpochFusion, packet: LandmarkPacket) -> Pairs:
        """Return (K, 2) rows of own landmarks and of the packet that show the same."""
        covariance, descriptors = fusing.landmark_covariance, fusing.joint.descriptors
        return self.frame(packet.vehicle).find_common(fusing.positions, covariance, descriptors, packet)

    def _named(self, fusing: EpochFusion, packet: LandmarkPacket) -> Pairs:
        """Return (K, 2) rows of own landmarks and of feedback, which names them in the peer's frame.

        None where it is for another vehicle, for an earlier start of this one, or of an earlier start of the peer.
        """
        nothing, addressee = np.zeros((0, 2), np.intp), fusing.joint.source
        record = self.inbox.peers.get(packet.vehicle)
        ended = record is not None and record.arrived[-1].session != packet.session
        if packet.other_sources[:1] != (addressee,) or ended:
            return nothing
        _, own, theirs = np.intersect1d(fusing.joint.ids, packet.ids, return_indices=True)
        pairs = np.column_stack([own, theirs])
        return self.frame(packet.vehicle).agreeing(fusing.positions, fusing.landmark_covariance, packet, pairs)

    def _note(self, peer: str, packet: LandmarkPacket, common: int) -> None:
        record = self.inbox.peers[peer]
        record.common_landmarks = common
        if common:
            record.used.add((packet.session, packet.sequence))
