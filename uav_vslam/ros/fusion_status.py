# SPDX-License-Identifier: Apache-2.0
"""Statistics of the cooperation: packets sent and held back, packets of each peer, silent peers."""

import time
from collections import defaultdict

from uav_vslam.cooperation.exchange import Exchange
from uav_vslam.cooperation.fusion import Fusion
from uav_vslam.ros.convert import header
from uav_vslam.ros.traffic import Interface, Rate
from uav_vslam.types import NS_PER_S
from uav_vslam_msgs.msg import FusionStatus, PeerLink


def account(link: PeerLink) -> str:
    """Return what became of a peer's packets."""
    drops = "".join(f", {n} {reason}" for reason, n in zip(link.drop_reasons, link.drop_counts, strict=True))
    return f"{link.packets_received} received: {link.packets_used} used, {link.packets_waiting} waiting{drops}"


class StatusReporter:
    """Makes fusion/status.

    Attributes:
        silent: peers that have not been received for too long, and for how long [s].
    """

    def __init__(self, vehicle: str, fusion: Fusion, exchange: Exchange, interface: Interface | None) -> None:
        self._vehicle, self._fusion, self._exchange, self._interface = vehicle, fusion, exchange, interface
        self._sent_rate, self._wire_rate = Rate(), Rate()
        self._received_rates: dict[str, Rate] = defaultdict(Rate)
        self._wire_start = (interface.sent_bytes, interface.received_bytes) if interface else (0, 0)
        self.silent: dict[str, float] = {}

    def report(self, stamp_ns: int, frame_id: str, *, own_weight: float) -> FusionStatus:
        """Return the message of an epoch; `own_weight` is the weight of the own information in its fusion."""
        mode, outbox = self._exchange.settings.mode, self._exchange.outbox
        peers = [self._peer(name, stamp_ns) for name in sorted(self._fusion.inbox.peers)]
        silent = (peer.peer for peer in peers if peer.silent and mode != "none")
        self.silent = {peer: self._fusion.inbox.silent_s(peer) for peer in silent}
        sent, received = self._wire()
        return FusionStatus(
            header=header(stamp_ns, frame_id),
            vehicle=self._vehicle,
            mode=mode,
            own_weight=own_weight,
            packets_sent=outbox.packets_sent,
            packets_held_back=self._exchange.dropped["budget"],
            bytes_sent=outbox.bytes_sent,
            sent_bytes_per_s=outbox.sent_bytes_per_s,
            recent_bytes_per_s=self._sent_rate.update(stamp_ns, outbox.bytes_sent),
            radio_interface=self._interface.name if self._interface else "",
            wire_sent_bytes=sent,
            wire_received_bytes=received,
            wire_sent_bytes_per_s=self._wire_rate.update(time.monotonic_ns(), sent),
            peers=peers,
        )

    def _wire(self) -> tuple[int, int]:
        """Return the bytes that the interface has sent and received since the start."""
        if self._interface is None:
            return 0, 0
        sent, received = self._wire_start
        return self._interface.sent_bytes - sent, self._interface.received_bytes - received

    def _peer(self, name: str, stamp_ns: int) -> PeerLink:
        record = self._fusion.inbox.peers[name]
        newest = record.arrived[-1]
        return PeerLink(
            peer=name,
            session=newest.session,
            last_sequence=newest.sequence,
            packets_received=record.received,
            packets_used=record.used,
            packets_waiting=record.waiting,
            received_bytes=self._exchange.received_bytes[name],
            received_bytes_per_s=self._received_rates[name].update(stamp_ns, self._exchange.received_bytes[name]),
            drop_reasons=list(record.dropped),
            drop_counts=list(record.dropped.values()),
            common_landmarks=record.common_landmarks,
            age_s=(stamp_ns + record.ahead_ns - newest.stamp_ns) / NS_PER_S,
            silent=self._fusion.inbox.silent_s(name) > self._exchange.settings.silent_after_s,
        )
