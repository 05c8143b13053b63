# SPDX-License-Identifier: Apache-2.0
"""Fusion of peers' packets into a copy of the own belief, at fixed epochs; nothing is ever written back.

Each epoch starts from the current own joint belief and fuses every peer's newest packet into it by split covariance
intersection. A packet whose sources and prior are disjoint from everything fused so far is independent and simply
adds; any overlap makes it dependent. In between, the own-only motion propagates the fused pose.
"""

import dataclasses
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from uav_vslam.config import FusionConfig
from uav_vslam.cooperation.authentication import authentication_for
from uav_vslam.cooperation.common_landmarks import comparable
from uav_vslam.cooperation.epoch_fusion import EpochFusion
from uav_vslam.cooperation.fused_pose import FusedEpoch, propagated
from uav_vslam.cooperation.inbox import DESCRIPTOR_SIZE, FEWER_COMMON, MIN_DELAY_S, Inbox
from uav_vslam.cooperation.loaded_map import LoadedMap
from uav_vslam.cooperation.own_landmarks import well_ranged
from uav_vslam.cooperation.peer_frame import CommonFrame, PeerFrame, UnknownFrame
from uav_vslam.estimation.belief import state_rows
from uav_vslam.geometry.pose import POSE_DIM
from uav_vslam.numerics import inverse_spd, submatrix
from uav_vslam.slam.landmark_memory import LandmarkMemory
from uav_vslam.slam.packet import ANCHOR, PacketPolicy, checksum, make_packet, packet_policy
from uav_vslam.slam.saved_map import SavedMap
from uav_vslam.types import NS_PER_S, JointInformation, LandmarkPacket, PoseEstimate

Pairs = NDArray[np.intp]

ENOUGH_SHARED = 5  # common landmarks; with fewer, an older packet that shares more is preferred
FEEDBACK = PacketPolicy(form=ANCHOR, max_landmarks=20)  # a few suffice, and one bound over many takes long


@dataclass(frozen=True, slots=True)
class _SharedRows:
    """The landmarks that a peer's packet has in common with the own belief.

    Attributes:
        source: "vehicle/session" of the peer.
        rows: (K,) of own landmarks.
        ids: (K,) the peer's identifiers of them.
    """

    source: str
    rows: NDArray[np.intp]
    ids: NDArray[np.uint32]


class Fusion:
    """The fusion node's core.

    Attributes:
        vehicle: its name.
        inbox: packets of peers.
        returned: feedback of peers: their fused estimates of own landmarks.
        belief: own belief of the last epoch, with remembered landmarks and without loose ones.
        loose: number of landmarks left out there, see `own_landmarks.well_ranged`.
        epoch: result of the last fusion.
    """

    def __init__(self, vehicle: str, config: FusionConfig, loaded: SavedMap | None = None) -> None:
        """Start without peers; `loaded` is a map of the ground, in the vehicle's own map frame."""
        self.vehicle = vehicle
        self._loaded = None if loaded is None else LoadedMap(loaded)
        self._authentication = authentication_for(vehicle, config)
        self.inbox = Inbox(vehicle, authentication=self._authentication)
        self.returned = Inbox(vehicle, authentication=self._authentication)
        self._config = config
        self._sequence = 0
        self.restart()

    def restart(self) -> None:
        """Forget the own belief and what was fused; inboxes and the packet count go on, so that no replay is taken."""
        self._memory = LandmarkMemory(self._config.memory_landmarks)
        self._frames: dict[str, PeerFrame] = {}
        self._used: dict[str, LandmarkPacket] = {}
        self._shared: set[int] = set()
        self._offered: set[int] = set()  # landmarks of the last packet, if no feedback reports on them
        self._times_sent: Counter[int] = Counter()  # how often each landmark of the estimate was sent
        self._shared_rows: dict[str, _SharedRows] = {}  # of each peer, at the last epoch
        self.belief: JointInformation | None = None
        self.loose = 0
        self.epoch: FusedEpoch | None = None

    def configure(self, config: FusionConfig) -> None:
        """Change the settings, as with the communication mode."""
        self._config = config

    def packet(self, *, byte_limit: int | None = None) -> LandmarkPacket:
        """Make the next packet from the own belief of the last epoch; fused values are never sent as own.

        Args:
            byte_limit: largest payload that the link accepts now.
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
        """Return the fused estimate of the landmarks that a peer sent, under the peer's identifiers.

        It contains the peer's measurements, so the peer intersects with it; it may contain other peers' too.
        """
        shared = self._shared_rows.get(peer)
        if self.belief is None or self.epoch is None or shared is None:
            return None
        columns = state_rows(POSE_DIM, shared.rows)
        fused = JointInformation(
            stamp_ns=self.belief.stamp_ns,
            vehicle=self.belief.vehicle,
            session=self.belief.session,
            T_map_body=self.epoch.pose.T_map_body,
            ids=shared.ids,
            positions=self.epoch.positions[shared.rows],
            information=inverse_spd(submatrix(self.epoch.covariance, columns), "fused landmarks"),
            descriptors=np.zeros((len(shared.ids), 0), np.uint8),
        )
        packet = make_packet(fused, sequence=self._sequence, policy=FEEDBACK, matched_ids=shared.ids.tolist())
        others = sorted(self.epoch.sources - {packet.source, shared.source})
        packet = dataclasses.replace(packet, sources=(packet.source, shared.source, *others))
        return self._authentication.sign(dataclasses.replace(packet, checksum=checksum(packet)))

    def fuse(self, joint: JointInformation) -> FusedEpoch:
        """Fuse each peer's newest packet, and feedback, that is old enough into the own belief."""
        if self.belief is not None and joint.session != self.belief.session:  # a restart renumbers the landmarks
            self._shared, self._offered, self._times_sent = set(), set(), Counter()
        for inbox in (self.inbox, self.returned):
            inbox.advance(joint.stamp_ns, joint.session)
        whole = self._memory.extended(joint, self._shared, self._offered)
        self.belief = well_ranged(whole)
        self.loose = len(whole.ids) - len(self.belief.ids)
        config = self._config
        fusing = EpochFusion(self.belief, scheme=config.scheme, weighing=config.weighing, prior_id=config.prior_id)
        self._shared_rows.clear()
        self._fuse_map(fusing)
        for peer, newest in self._newest(self.inbox):
            if not comparable(joint.descriptors, newest):
                self.inbox.peers[peer].mark(newest, DESCRIPTOR_SIZE)
                continue
            packet, pairs = self._select(fusing, newest)
            self.inbox.peers[peer].record_use(packet, len(pairs))
            fusing.common[peer] = len(pairs)
            fusing.add(packet, pairs, self.frame(peer))
            if len(pairs):
                self._shared_rows[peer] = _SharedRows(packet.source, pairs[:, 0], packet.ids[pairs[:, 1]])
        for peer, packet in self._newest(self.returned):
            pairs = self._matched_by_id(fusing, packet)
            self.returned.peers[peer].record_use(packet, len(pairs))
            fusing.add(packet, pairs, self.frame(peer), feedback=True)
        self._shared = self._shared & set(self.belief.ids.tolist()) | fusing.matched
        self.epoch = fusing.epoch()
        self._carried = self.epoch.own, self.epoch.pose
        return self.epoch

    def _fuse_map(self, fusing: EpochFusion) -> None:
        if self._loaded is None:
            return
        frame = CommonFrame(self._config)
        found = self._loaded.common(fusing.landmarks, frame)
        if found is not None:
            fusing.add_map(*found, frame)

    def frame(self, peer: str) -> PeerFrame:
        """Return the relation of a peer's map frame to ours."""
        if peer not in self._frames:
            self._frames[peer] = (CommonFrame if self._config.common_origin else UnknownFrame)(self._config)
        return self._frames[peer]

    def propagate(self, own: PoseEstimate) -> PoseEstimate:
        """Return the last fused pose, propagated by the own-only motion since; call it for each own pose, in order."""
        if self.epoch is None:
            return own
        self._carried = own, propagated(*self._carried, own)
        return self._carried[1]

    def _newest(self, inbox: Inbox) -> Iterator[tuple[str, LandmarkPacket]]:
        """Yield each peer's newest packet that this epoch may use."""
        assert self.belief is not None
        not_after_ns = self.belief.stamp_ns - round(MIN_DELAY_S * NS_PER_S)
        for peer in sorted(inbox.peers) if self._config.mode != "none" else ():
            packet = inbox.newest(peer, not_after_ns)
            if packet is not None:
                yield peer, packet

    def _select(self, fusing: EpochFusion, newest: LandmarkPacket) -> tuple[LandmarkPacket, Pairs]:
        """Return the packet of a peer to fuse: the newest, or the last one used if only that shares enough landmarks.

        Without a common origin always the newest: frame estimation uses every packet once, in order.
        """
        pairs, last = self._common(fusing, newest), self._used.get(newest.vehicle)
        if last is not None and len(pairs) < ENOUGH_SHARED and self._may_replace(newest, last):
            before = self._common(fusing, last)
            if len(before) > len(pairs):
                self.inbox.peers[newest.vehicle].mark(newest, FEWER_COMMON)
                return last, before
        self._used[newest.vehicle] = newest
        return newest, pairs

    def _may_replace(self, newest: LandmarkPacket, last: LandmarkPacket) -> bool:
        """Return whether the last packet used of a peer may be fused once more in place of the newest."""
        another = last is not newest and last.session == newest.session
        return another and self._config.common_origin and self.inbox.peers[newest.vehicle].can_use(last)

    def _common(self, fusing: EpochFusion, packet: LandmarkPacket) -> Pairs:
        """Return (K, 2) rows of common landmarks: own, and the packet's."""
        return self.frame(packet.vehicle).find_common(fusing.landmarks, packet)

    def _matched_by_id(self, fusing: EpochFusion, packet: LandmarkPacket) -> Pairs:
        """Return (K, 2) rows of own landmarks and of feedback with equal identifiers, checked in the peer's frame.

        Empty if it is for another vehicle, for an earlier session of this one, or of an earlier session of the peer.
        """
        nothing, addressee = np.zeros((0, 2), np.intp), fusing.joint.source
        record = self.inbox.peers.get(packet.vehicle)
        ended = record is not None and record.arrived[-1].session != packet.session
        if packet.other_sources[:1] != (addressee,) or ended:
            return nothing
        _, own, theirs = np.intersect1d(fusing.joint.ids, packet.ids, return_indices=True)
        pairs = np.column_stack([own, theirs])
        return self.frame(packet.vehicle).agreeing(fusing.landmarks, packet, pairs)
