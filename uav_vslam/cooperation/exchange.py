# SPDX-License-Identifier: Apache-2.0
"""The exchange policy of one vehicle: which packets it sends, accepts, relays and drops, over any transport.

The ROS node's radio and the offline twin's links are transports: they carry packets and decide nothing.
"""

from collections import Counter
from collections.abc import Callable, Collection, Sequence
from typing import Protocol

from uav_vslam.config import FusionConfig
from uav_vslam.cooperation.fusion import Fusion
from uav_vslam.cooperation.outbox import Outbox
from uav_vslam.errors import InvalidMessage
from uav_vslam.slam.packet import payload_bytes
from uav_vslam.types import LandmarkPacket

# A relayed packet often arrives twice, late, or at the vehicle that made it: the inbox counts that; it is no drop.
EXPECTED_OF_RELAYS = ("own", "duplicate", "late", "stale_session", "other_session")


class Receiver(Protocol):
    """Where a transport delivers packets."""

    def on_packet(self, sender: str, packet: LandmarkPacket, size_bytes: int) -> None:
        """Receive a packet that a peer sent; its size is that on the radio."""

    def on_feedback(self, packet: LandmarkPacket, size_bytes: int) -> None:
        """Receive another vehicle's fused estimate of own landmarks."""


class Transport(Protocol):
    """Carries one vehicle's packets to its peers, and theirs to it."""

    @property
    def copies(self) -> int:
        """Transmissions that a packet to all peers takes now."""

    @property
    def expected_copies(self) -> int:
        """Transmissions that a packet to all peers takes once all of them listen."""

    @property
    def now_ns(self) -> int:
        """Time that passes with or without own epochs, from any origin [ns]."""

    def tune(self, settings: FusionConfig, receiver: Receiver) -> None:
        """Change to the communication mode of the settings; later packets go to the receiver."""

    def send(self, packet: LandmarkPacket, to: Collection[str]) -> None:
        """Send a packet to some peers; on a shared channel the others receive it too."""

    def send_feedback(self, packet: LandmarkPacket, peer: str) -> None:
        """Send feedback to one peer alone."""


class Exchange:
    """The policy, in one communication mode at a time.

    Attributes:
        settings: the current ones.
        outbox: what was sent.
        received_bytes: size of all packets received, by sender.
        dropped: packets refused or held back, by reason; of relayed ones only for reasons not in `EXPECTED_OF_RELAYS`.
    """

    def __init__(
        self,
        fusion: Fusion,
        peers: Sequence[str],
        transport: Transport,
        settings: FusionConfig,
        *,
        on_drop: Callable[[str, str], None] = lambda *_: None,
    ) -> None:
        """Prepare; nothing is sent or received before `configure`.

        Args:
            fusion: makes own packets and receives the peers'.
            peers: names of the other vehicles of the fleet.
            transport: carries the packets.
            settings: initial ones.
            on_drop: called with reason and detail of each drop.
        """
        self._fusion, self._peers, self._transport, self._on_drop = fusion, tuple(peers), transport, on_drop
        self.settings = settings
        self._channels: tuple[str, bool] | None = None  # mode, and whether feedback is sent
        self.outbox = Outbox(settings, lambda: transport.now_ns)
        self.received_bytes: Counter[str] = Counter()
        self.dropped: Counter[str] = Counter()

    def configure(self, settings: FusionConfig) -> None:
        """Start, or continue with other settings; the transport changes only with the topics that it needs."""
        self.settings = settings
        self._fusion.configure(settings)
        self.outbox.configure(settings, copies=self._transport.expected_copies)
        channels = settings.mode, settings.returns_feedback
        if channels != self._channels:
            self._channels = channels
            self._transport.tune(settings, self)

    def restart(self) -> None:
        """Go on by a clock that may have been set back."""
        self.outbox.restart_clock()

    def send(self) -> None:
        """Send the packet of the last fused epoch, and feedback, within the budget."""
        assert self._fusion.belief is not None  # an epoch has been fused
        stamp_ns, copies = self._fusion.belief.stamp_ns, self._transport.copies
        if not self.outbox.should_send(stamp_ns, copies=copies):
            return
        packet = self._fusion.packet(byte_limit=self.outbox.available(stamp_ns) // copies)
        if self._reserve(packet, copies):
            self._transport.send(packet, self._peers)
        if self.settings.returns_feedback:
            for peer in self._peers:
                feedback = self._fusion.feedback(peer)
                if feedback is not None and self._reserve(feedback):
                    self._transport.send_feedback(feedback, peer)

    def on_packet(self, sender: str, packet: LandmarkPacket, size_bytes: int) -> None:
        """Receive a packet that the sender made, or relays unchanged."""
        if self.settings.mode == "none":
            return
        if sender != self._fusion.vehicle:
            self.received_bytes[sender] += size_bytes
        try:
            self._check_packet(sender, packet)
            self._fusion.inbox.go_on(self._transport.now_ns)
            self._fusion.inbox.add(packet)
        except InvalidMessage as error:
            relayed = packet.vehicle != sender or sender == self._fusion.vehicle
            if not relayed or error.reason not in EXPECTED_OF_RELAYS:
                self._drop(error.reason, f"packet from {sender}: {error}")
            return
        self.outbox.on_packet()
        if self.settings.relay:
            self._relay(packet, [peer for peer in self._peers if peer not in (sender, packet.vehicle)])

    def on_feedback(self, packet: LandmarkPacket, size_bytes: int) -> None:
        """Receive a peer's fused estimate of own landmarks."""
        if not self.settings.returns_feedback:
            return
        try:
            if packet.vehicle not in self._peers:
                raise InvalidMessage("sender", f"{packet.vehicle!r} is no peer")
            self.received_bytes[packet.vehicle] += size_bytes
            self._fusion.returned.go_on(self._transport.now_ns)
            self._fusion.returned.add(packet)
        except InvalidMessage as error:
            self._drop(error.reason, f"feedback: {error}")
            return
        self.outbox.on_packet()

    def _check_packet(self, sender: str, packet: LandmarkPacket) -> None:
        """Refuse packets of vehicles outside the fleet, and feedback where packets are expected."""
        if packet.vehicle not in (*self._peers, self._fusion.vehicle):
            raise InvalidMessage("sender", f"{sender} sends a packet of {packet.vehicle!r}, which is not of the fleet")
        if packet.other_sources and not packet.prior_id:  # those of a map are declared with its hash
            raise InvalidMessage("sources", f"{packet.source} sends feedback where packets are expected")

    def _relay(self, packet: LandmarkPacket, to: Sequence[str]) -> None:
        if to and self._reserve(packet, self._transport.copies):
            self._transport.send(packet, to)

    def _reserve(self, packet: LandmarkPacket, copies: int = 1) -> bool:
        """Charge a packet to the budget, or count it as held back: the next epoch's replaces it.

        The time is the own one: the stamp of a peer's packet may be wrong.
        """
        size, now_ns = payload_bytes(packet) * copies, self.outbox.budget_ns()
        left = self.outbox.available(now_ns)
        if self.outbox.try_reserve(now_ns, size):
            return True
        self._drop(
            "budget", f"packet {packet.sequence} of {packet.source} needs {size} B: the budget has {left} B left"
        )
        return False

    def _drop(self, reason: str, detail: str) -> None:
        self.dropped[reason] += 1
        self._on_drop(reason, detail)
