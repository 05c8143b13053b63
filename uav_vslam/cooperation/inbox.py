# SPDX-License-Identifier: Apache-2.0
"""The packets of peers: validated, counted, and at most one per vehicle used at a time.

A packet is a self-contained marginal, and a newer one replaces an older one whole. So loss, duplication and reordering
are harmless, and nothing is counted twice. Which session of a peer counts is in `cooperation.sessions`. With keys,
replayed packets are harmless too: an older session, or a packet received or superseded before, is refused, as far back
as this vehicle has listened. (A replay before the peer's first new packet is accepted as new; that packet then replaces
it.)

Each received packet of a peer is used, dropped for one reason, or waiting: `received == used + dropped + waiting`.
One that was kept and then put out unused is dropped for the reason that it would have had at its last epoch.
"""

from collections import Counter, deque
from dataclasses import dataclass, field

from uav_vslam.cooperation.authentication import Authentication, NoAuthentication
from uav_vslam.cooperation.sessions import Sessions
from uav_vslam.errors import InvalidMessage
from uav_vslam.slam.packet import check_contents, check_form
from uav_vslam.types import NS_PER_S, LandmarkPacket

KEPT_PER_PEER = 4  # recent packets, so that an epoch finds one that is old enough
MOST_AHEAD = 16  # further ones of a peer that is ahead: with fewer, none would be left when its time comes
RECENTLY_USED = 1000  # packets whose number is remembered, of a quarter of an hour
MIN_DELAY_S = 0.2  # only packets this much older than the epoch are fused, so that replays are deterministic
MAX_PEERS = 64  # forged names must not fill the memory
NO_EPOCHS_S = 5.0  # own epochs have stopped; in a replay a busy computer may take seconds for one
NAMESAKE_S = 10.0  # one that is silent for so long has gone

# Why a packet that was kept is dropped in the end.
SUPERSEDED = "superseded"  # an epoch took a newer one
FEWER_COMMON = "fewer_common"  # one before it shared more landmarks
NOTHING_COMMON = "nothing_common"  # none of its landmarks was an own one
DESCRIPTOR_SIZE = "descriptor_size"  # its descriptors can't be compared with the own ones
EMPTY = "empty"
SESSION_ENDED = "session_ended"
AHEAD = "ahead"  # too many of the peer's packets were waiting for their time already

_NO_KEY_HERE = "signs its packets, but this vehicle has no key (fusion.fleet_key_file): they are used unverified"
_KEY_FAULTS = {  # by reason of the refusal
    "unsigned": "does not sign its packets, and this vehicle has a key: they are refused",
    "signature": "has another key than this vehicle, or its packets are forged: they are refused",
}


@dataclass(slots=True)
class PeerRecord:
    """The packets and counts of one peer.

    Attributes:
        sessions: which of its sessions counts.
        packets: kept ones of the session that counts, with landmarks, by order.
        arrived: the same and those without.
        received: all that arrived in its name.
        used: number of those that shared a landmark at some epoch.
        recently_used: session and sequence of the last of them.
        last_used: order of the last one.
        unused: kept ones that were not used so far, by order: why they will have been dropped if they never are.
        dropped: those that will never be used, by reason.
        common_landmarks: shared at the last epoch.
    """

    sessions: Sessions
    packets: list[LandmarkPacket] = field(default_factory=list)
    arrived: list[LandmarkPacket] = field(default_factory=list)
    received: int = 0
    used: int = 0
    recently_used: deque[tuple[int, int]] = field(default_factory=lambda: deque(maxlen=RECENTLY_USED))
    last_used: tuple[int, int] | None = None
    unused: dict[tuple[int, int], str] = field(default_factory=dict)
    dropped: Counter[str] = field(default_factory=Counter)
    common_landmarks: int = 0

    @property
    def ahead_ns(self) -> int:
        """How far the peer's clock counts as ahead of the own one [ns]."""
        return self.sessions.ahead_ns or 0

    @property
    def waiting(self) -> int:
        """Number of packets that may still be used."""
        return len(self.unused)

    def keep(self, packet: LandmarkPacket, now_ns: int) -> None:
        """Keep a packet for the epochs after `now_ns` [ns]; the oldest make room, or what is too many ahead."""
        now_ns += self.ahead_ns
        self.unused[packet.order] = SUPERSEDED if len(packet) else EMPTY
        _keep(packet, self.arrived, now_ns)
        if len(packet):  # an empty one, from a full link or an empty view, does not replace the one before
            _keep(packet, self.packets, now_ns)
        self._settle()

    def withdraw(self) -> None:
        """Drop what is kept: the session has ended."""
        self.arrived.clear()
        self.packets.clear()
        self.unused = dict.fromkeys(self.unused, SESSION_ENDED)
        self._settle()

    def record_use(self, packet: LandmarkPacket, common: int) -> None:
        """Record how many landmarks a packet shared at an epoch."""
        self.common_landmarks = common
        if common == 0:
            self.mark(packet, NOTHING_COMMON)
        elif packet.order in self.unused:
            del self.unused[packet.order]
            self.used += 1
            self.recently_used.append((packet.session, packet.sequence))
            self.last_used = packet.order

    def mark(self, packet: LandmarkPacket, reason: str) -> None:
        """Record why an epoch did not use a packet; a later one may."""
        if packet.order in self.unused:
            self.unused[packet.order] = reason

    def can_use(self, packet: LandmarkPacket) -> bool:
        """Return whether a packet of the current session has not been dropped."""
        return packet.order in self.unused or packet.order == self.last_used

    def _settle(self) -> None:
        kept = {p.order for p in (*self.arrived, *self.packets)}
        for order in self.unused.keys() - kept:
            reason = self.unused.pop(order)
            self.dropped[AHEAD if kept and order > max(kept) else reason] += 1


class Inbox:
    """One record per peer.

    Attributes:
        peers: records by name, of vehicles that sent a valid packet.
        refused: counts of packets of all others, by reason.
        now_ns: own time: the stamp of the last own epoch, later once they have stopped, 0 before the first [ns].
        namesakes: other sessions of this vehicle's own name that go on, with the own time of the last packet of each.
        key_faults: what is wrong with the keys of a vehicle whose last packet was not verified.
    """

    def __init__(self, vehicle: str, *, authentication: Authentication | None = None) -> None:
        self._vehicle = vehicle
        self._authentication = authentication or NoAuthentication()
        self.peers: dict[str, PeerRecord] = {}
        self.refused: Counter[str] = Counter()
        self.now_ns = 0
        self._epoch_ns = 0
        self._clock_ns: int | None = None  # a clock that goes on without epochs, at the first packet after the last one
        self.namesakes: dict[int, int] = {}
        self.key_faults: dict[str, str] = {}
        self._own: tuple[int, int] | None = None  # own session, and stamp of its first epoch

    def advance(self, now_ns: int, session: int) -> None:
        """Set the time and the own session: those of the epoch that is to be fused."""
        if self._epoch_ns <= now_ns < self.now_ns:  # the epochs go on behind the clock: it has not been set back
            for record in self.peers.values():
                record.sessions.received_ns = min(record.sessions.received_ns, now_ns)
        self.now_ns = self._epoch_ns = now_ns
        self._clock_ns = None
        if self._own is None or self._own[0] != session:
            self._own = session, now_ns
        kept_ns = NAMESAKE_S * NS_PER_S
        self.namesakes = {k: at_ns for k, at_ns in self.namesakes.items() if 0 <= now_ns - at_ns <= kept_ns}

    def go_on(self, clock_ns: int) -> None:
        """Let the own time go on where own epochs have stopped, or peers would seem to be ahead; to be called often.

        Args:
            clock_ns: a clock that goes on without epochs, from any origin.
        """
        self._clock_ns = clock_ns if self._clock_ns is None else self._clock_ns
        waited_ns = clock_ns - self._clock_ns - round(NO_EPOCHS_S * NS_PER_S)
        if self._epoch_ns:
            self.now_ns = self._epoch_ns + max(waited_ns, 0)

    def add(self, packet: LandmarkPacket) -> None:
        """Store a packet, or count why it was refused.

        Raises:
            InvalidMessage: it is damaged, malformed, forged, stale, repeated, or this vehicle's own.
        """
        record = self.peers.get(packet.vehicle)
        try:
            self._check(packet)
            record = record or self._new_record(packet)
            self._enter(packet, record)
        except InvalidMessage as error:
            if record is None:
                self.refused[error.reason] += 1
            else:
                record.received += 1
                record.dropped[error.reason] += 1
            raise
        record.received += 1
        record.keep(packet, self.now_ns)

    def newest(self, peer: str, not_after_ns: int) -> LandmarkPacket | None:
        """Return the peer's newest packet made at or before a stamp, of the own clock."""
        record = self.peers.get(peer)
        old_enough = [p for p in record.packets if p.stamp_ns - record.ahead_ns <= not_after_ns] if record else []
        return old_enough[-1] if old_enough else None

    def silent_s(self, peer: str) -> float:
        """Return the own time without a packet of a peer's session that counts, since the own start at most [s]."""
        if self._own is None:
            return 0.0
        received_ns = self.peers[peer].sessions.received_ns
        was_heard = self._own[1] <= received_ns <= self.now_ns
        return (self.now_ns - (received_ns if was_heard else self._own[1])) / NS_PER_S

    def _check(self, packet: LandmarkPacket) -> None:
        if packet.vehicle == self._vehicle and (self._own is None or packet.session == self._own[0]):
            raise InvalidMessage("own", f"a packet claims to come from {self._vehicle} itself")
        check_form(packet)
        self._verify(packet)
        if packet.vehicle == self._vehicle:
            self._refuse_namesake(packet)
        check_contents(packet)

    def _verify(self, packet: LandmarkPacket) -> None:
        """Check the tag, and remember what the last one says about the sender's keys."""
        try:
            self._authentication.check(packet)
        except InvalidMessage as error:
            self._note_keys(packet.vehicle, _KEY_FAULTS.get(error.reason, ""))
            raise
        self._note_keys(packet.vehicle, _NO_KEY_HERE if packet.tag and not self._authentication.tag_bytes else "")

    def _note_keys(self, vehicle: str, fault: str) -> None:
        self.key_faults.pop(vehicle, None)
        if fault and len(self.key_faults) < MAX_PEERS:
            self.key_faults[vehicle] = f"{vehicle} {fault}"

    def _refuse_namesake(self, packet: LandmarkPacket) -> None:
        """Refuse a packet of an own earlier session, or of another vehicle that has this one's name."""
        assert self._own is not None  # checked before
        if packet.stamp_ns <= self._own[1]:
            raise InvalidMessage("own", f"a packet comes from {self._vehicle} itself, before its restart")
        self.namesakes = {packet.session: self.now_ns}  # the last one: forged numbers must not fill the memory
        raise InvalidMessage("namesake", f"another vehicle called {self._vehicle} sends, session {packet.session}")

    def _enter(self, packet: LandmarkPacket, record: PeerRecord) -> None:
        """Refuse a packet that was received before, superseded or withdrawn, or of a time that can't be."""
        if record.sessions.add(packet, self.now_ns, proven=self._authentication.tag_bytes > 0):
            record.withdraw()
        _check_order(packet, record.arrived)

    def _new_record(self, packet: LandmarkPacket) -> PeerRecord:
        if len(self.peers) >= MAX_PEERS:
            raise InvalidMessage("too_many_peers", f"{packet.vehicle!r} would be peer {MAX_PEERS + 1}")
        sessions = Sessions(packet.session, packet.stamp_ns, self.now_ns)
        return self.peers.setdefault(packet.vehicle, PeerRecord(sessions))


def _keep(packet: LandmarkPacket, among: list[LandmarkPacket], now_ns: int) -> None:
    """Add a packet, and keep the newest that is old enough to be fused, and those whose time comes first."""
    among.append(packet)
    among.sort(key=lambda p: p.order)
    old_enough_ns = now_ns - round(MIN_DELAY_S * NS_PER_S)
    ahead = sum(p.stamp_ns > old_enough_ns for p in among) if now_ns else 0
    del among[len(among) - ahead + MOST_AHEAD :]
    del among[: -max(KEPT_PER_PEER, min(ahead, MOST_AHEAD) + 1)]


def _check_order(packet: LandmarkPacket, kept: list[LandmarkPacket]) -> None:
    """Refuse a packet that was received before or superseded."""
    if any(p.order == packet.order for p in kept):
        raise InvalidMessage("duplicate", f"packet {packet.sequence} of {packet.source} was received twice")
    if len(kept) >= KEPT_PER_PEER and packet.order < kept[0].order:
        raise InvalidMessage("late", f"packet {packet.sequence} of {packet.source} is older than the oldest one kept")
