# SPDX-License-Identifier: Apache-2.0
"""The packets that peers sent: validated, counted, and at most one per vehicle ever used at a time.

A packet is a self-contained marginal, and a newer one (session, then sequence) replaces an older one whole. So loss,
duplication and reordering are harmless, and nothing is counted twice.
"""

from collections import Counter
from dataclasses import dataclass, field

from uav_vslam.errors import InvalidMessage
from uav_vslam.slam.packet import validate
from uav_vslam.types import LandmarkPacket

KEPT_PER_PEER = 4  # recent packets, so that an epoch can be served with one old enough


@dataclass(slots=True)
class PeerRecord:
    """What one peer sent."""

    packets: list[LandmarkPacket] = field(default_factory=list)  # by (session, sequence)
    received: int = 0
    used: set[tuple[int, int]] = field(default_factory=set)
    dropped: Counter[str] = field(default_factory=Counter)
    common_landmarks: int = 0


class Inbox:
    """One record a peer."""

    def __init__(self, vehicle: str) -> None:
        self._vehicle = vehicle
        self.peers: dict[str, PeerRecord] = {}

    def add(self, packet: LandmarkPacket) -> None:
        """Take a packet in, or count why not.

        Raises:
            InvalidMessage: it is damaged, malformed, stale, repeated, or this vehicle's own.
        """
        if packet.vehicle == self._vehicle:
            raise InvalidMessage("own", f"a packet claims to come from {self._vehicle} itself")
        record = self.peers.setdefault(packet.vehicle, PeerRecord())
        record.received += 1
        try:
            self._check(packet, record)
        except InvalidMessage as error:
            record.dropped[error.reason] += 1
            raise
        session = record.packets[-1].session if record.packets else packet.session
        if packet.session > session:
            record.packets.clear()  # a restart withdraws what the earlier session said
        record.packets.append(packet)
        record.packets.sort(key=lambda p: p.sequence)
        del record.packets[:-KEPT_PER_PEER]

    def newest(self, peer: str, not_after_ns: int) -> LandmarkPacket | None:
        """Return the peer's newest packet made at or before a stamp."""
        record = self.peers.get(peer)
        old_enough = [p for p in record.packets if p.stamp_ns <= not_after_ns] if record else []
        return old_enough[-1] if old_enough else None

    def _check(self, packet: LandmarkPacket, record: PeerRecord) -> None:
        validate(packet)
        if record.packets and packet.session < record.packets[-1].session:
            raise InvalidMessage("stale_session", f"session {packet.session} of {packet.vehicle} has ended")
        if any((p.session, p.sequence) == (packet.session, packet.sequence) for p in record.packets):
            raise InvalidMessage("duplicate", f"packet {packet.sequence} of {packet.source} came twice")
        if (
            len(record.packets) == KEPT_PER_PEER
            and packet.session == record.packets[0].session
            and packet.sequence < record.packets[0].sequence
        ):
            raise InvalidMessage("late", f"packet {packet.sequence} of {packet.source} is older than the last kept")
