# SPDX-License-Identifier: Apache-2.0
"""Which session of a peer counts: the one received first, until it has been silent for `HANDOVER_S`.

A vehicle that starts again has a larger session number, and is silent for seconds in between, so it waits little. A
forged number, or a second vehicle of the same name, finds the first one still sending, and is not fused. Time is that
of the own epochs, and once these have stopped, of the own computer: nobody else can set it. When it has been set back,
as that of a whole fleet is by a recording that begins again, earlier packets are no evidence: as at the start, the
session received first counts at once.

Vehicles need no common time: the clock of a computer without a network may be off by hours. A session whose stamps are
far ahead from the start on, or after a silence, comes from such a clock, and its packets are used as they arrive.

Of two sessions of one vehicle, all stamps of the earlier are before all of the later. Stamps that contradict this show
two senders; the fusion node names them.
"""

from dataclasses import dataclass

from uav_vslam.errors import InvalidMessage
from uav_vslam.types import NS_PER_S, LandmarkPacket

HANDOVER_S = 5.0
FUTURE_S = 10.0  # stamps ahead of the own epochs by less wait for their time


@dataclass(slots=True)
class Rival:
    """Another session than the one that counts.

    Attributes:
        session: its number.
        first_ns: stamp of its first packet [ns].
        received_ns: own time of its last packet [ns].
        contradicts: both sessions go on at the same time.
    """

    session: int
    first_ns: int
    received_ns: int
    contradicts: bool = False


@dataclass(slots=True)
class Sessions:
    """The sessions of one peer.

    Attributes:
        current: number of the one that counts.
        began_ns: stamp of its first packet [ns].
        received_ns: own time of its last packet [ns].
        rival: the last other one.
        ahead_ns: how far the sender's clock counts as ahead of the own one [ns]; None while the own time is unknown.
    """

    current: int
    began_ns: int
    received_ns: int
    rival: Rival | None = None
    ahead_ns: int | None = None

    def add(self, packet: LandmarkPacket, now_ns: int, *, proven: bool) -> bool:
        """Record a packet's session; return whether it takes the place of the current one.

        Args:
            packet: valid.
            now_ns: own time.
            proven: the sender has proven its name, so that an earlier session can only be a repetition.

        Raises:
            InvalidMessage: with reason stale_session, other_session or future, the packet does not count.
        """
        silent = not 0 <= now_ns - self.received_ns < HANDOVER_S * NS_PER_S  # or the own time has been set back
        if packet.session == self.current:
            self._follow_clock(packet, now_ns, silent=silent)
            self._add_current(packet, now_ns)
            return False
        later = packet.session > self.current
        if (later or not proven) and silent:
            self.current, self.began_ns, self.received_ns, self.rival = packet.session, packet.stamp_ns, now_ns, None
            self._follow_clock(packet, now_ns, silent=True)
            return True
        self._add_rival(packet, now_ns)
        reason = "other_session" if later else "stale_session"
        raise InvalidMessage(reason, f"session {packet.session} of {packet.vehicle}: session {self.current} counts")

    def contradicting(self, now_ns: int) -> int | None:
        """Return the other session that sends at the same time as the current one, if any."""
        rival = self.rival
        if rival is None or not rival.contradicts or now_ns - rival.received_ns > HANDOVER_S * NS_PER_S:
            return None
        return rival.session

    def _follow_clock(self, packet: LandmarkPacket, now_ns: int, *, silent: bool) -> None:
        """Find out how far the sender's clock is ahead, at the first packet and after a silence.

        Raises:
            InvalidMessage: the stamp is much farther ahead than those before.
        """
        if now_ns == 0:
            return
        ahead_ns, tolerated_ns = packet.stamp_ns - now_ns, FUTURE_S * NS_PER_S
        if self.ahead_ns is None or silent:
            self.ahead_ns = ahead_ns if ahead_ns > tolerated_ns else 0
        elif ahead_ns - self.ahead_ns > tolerated_ns:
            farther_s = (ahead_ns - self.ahead_ns) / NS_PER_S
            raise InvalidMessage("future", f"packet {packet.sequence} of {packet.source} is {farther_s:.0f} s ahead")

    def _add_current(self, packet: LandmarkPacket, now_ns: int) -> None:
        self.received_ns = now_ns
        rival = self.rival
        if rival is not None and rival.session > self.current and packet.stamp_ns > rival.first_ns:
            rival.contradicts = True

    def _add_rival(self, packet: LandmarkPacket, now_ns: int) -> None:
        if self.rival is None or self.rival.session != packet.session:
            self.rival = Rival(packet.session, packet.stamp_ns, now_ns)
        self.rival.received_ns = now_ns
        if packet.session < self.current and packet.stamp_ns > self.began_ns:
            self.rival.contradicts = True
