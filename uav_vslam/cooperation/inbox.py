# SPDX-License-Identifier: Apache-2.0
"""The packets of peers: validated, counted, and at most one per vehicle used at a time.

A packet is a self-contained marginal, and a newer one (session, then stamp) replaces an older one whole. So loss,
duplication and reordering are harmless, and nothing is counted twice. Replayed packets are harmless too: an older
session, or a packet received or superseded before, is refused, as far back as this vehicle has listened. (A replay
before the peer's first new packet is accepted as new; that packet then replaces it.)
"""

from collections import Counter
from dataclasses import dataclass, field

from uav_vslam.cooperation.authentication import Authentication, NoAuthentication
from uav_vslam.errors import InvalidMessage
from uav_vslam.slam.packet import check_contents, check_form
from uav_vslam.types import LandmarkPacket

KEPT_PER_PEER = 4  # recent packets, so that an epoch finds one that is old enough
MAX_PEERS = 64  # forged names must not fill the memory


@dataclass(slots=True)
class PeerRecord:
    """The packets and counts of one peer."""

    packets: list[LandmarkPacket] = field(default_factory=list)  # of the newest session, those with landmarks, by order
    arrived: list[LandmarkPacket] = field(default_factory=list)  # the same and those without
    received: int = 0
    used: set[tuple[int, int]] = field(default_factory=set)
    dropped: Counter[str] = field(default_factory=Counter)
    common_landmarks: int = 0


class Inbox:
    """One record per peer.

    Attributes:
        peers: records by name, of vehicles that sent a valid packet.
        refused: counts of packets of all others, by reason.
    """

    def __init__(self, vehicle: str, *, authentication: Authentication | None = None) -> None:
        self._vehicle = vehicle
        self._authentication = authentication or NoAuthentication()
        self.peers: dict[str, PeerRecord] = {}
        self.refused: Counter[str] = Counter()

    def add(self, packet: LandmarkPacket) -> None:
        """Store a packet, or count why it was refused.

        Raises:
            InvalidMessage: it is damaged, malformed, forged, stale, repeated, or this vehicle's own.
        """
        record = self.peers.get(packet.vehicle)
        try:
            self._check(packet)
            record = record or self._new_record(packet.vehicle)
            _check_order(packet, record.arrived)
        except InvalidMessage as error:
            if record is None:
                self.refused[error.reason] += 1
            else:
                record.received += 1
                record.dropped[error.reason] += 1
            raise
        record.received += 1
        if record.arrived and packet.session > record.arrived[-1].session:
            record.arrived.clear()
            record.packets.clear()  # a restart withdraws the packets of the earlier session
        _keep(packet, record.arrived)
        if len(packet):  # an empty one, from a full link or an empty view, does not replace the one before
            _keep(packet, record.packets)

    def newest(self, peer: str, not_after_ns: int) -> LandmarkPacket | None:
        """Return the peer's newest packet made at or before a stamp."""
        record = self.peers.get(peer)
        old_enough = [p for p in record.packets if p.stamp_ns <= not_after_ns] if record else []
        return old_enough[-1] if old_enough else None

    def _check(self, packet: LandmarkPacket) -> None:
        if packet.vehicle == self._vehicle:
            raise InvalidMessage("own", f"a packet claims to come from {self._vehicle} itself")
        check_form(packet)
        self._authentication.check(packet)
        check_contents(packet)

    def _new_record(self, vehicle: str) -> PeerRecord:
        if len(self.peers) >= MAX_PEERS:
            raise InvalidMessage("too_many_peers", f"{vehicle!r} would be peer {MAX_PEERS + 1}")
        return self.peers.setdefault(vehicle, PeerRecord())


def _keep(packet: LandmarkPacket, among: list[LandmarkPacket]) -> None:
    among.append(packet)
    among.sort(key=lambda p: p.order)
    del among[:-KEPT_PER_PEER]


def _check_order(packet: LandmarkPacket, kept: list[LandmarkPacket]) -> None:
    """Refuse a packet that was received before, superseded or withdrawn."""
    if not kept or packet.session > kept[-1].session:
        return
    if packet.session < kept[-1].session:
        raise InvalidMessage("stale_session", f"session {packet.session} of {packet.vehicle} has ended")
    if any(p.order == packet.order for p in kept):
        raise InvalidMessage("duplicate", f"packet {packet.sequence} of {packet.source} was received twice")
    if len(kept) == KEPT_PER_PEER and packet.order < kept[0].order:
        raise InvalidMessage("late", f"packet {packet.sequence} of {packet.source} is older than the oldest one kept")
