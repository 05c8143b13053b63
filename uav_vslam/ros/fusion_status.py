# SPDX-License-Identifier: Apache-2.0
"""How cooperation goes, in numbers: what was sent and held back, what each peer's packets brought, who fell silent."""

import time
from collections import Counter, defaultdict

from uav_vslam.cooperation.fusion import Fusion
from uav_vslam.cooperation.outbox import Outbox
from uav_vslam.ros.convert import header
from uav_vslam.ros.traffic import Interface, Rate
from uav_vslam.types import NS_PER_S
from uav_vslam_msgs.msg import FusionStatus, PeerLink


class StatusReporter:
    """Makes fusion/status.

    Attributes:
        received_bytes: serialised size of all packets that came, by peer.
        silent: peers whose newest packet is too old, with its age [s].
    """

    def __init__(self, vehicle: str, fusion: Fusion, outbox: Outbox, interface: Interface | None) -> None:
        self._vehicle, self._fusion, self._outbox, self._interface = vehicle, fusion, outbox, interface
        self._sent_rate, self._wire_rate = Rate(), Rate()
        self._received_rates: dict[str, Rate] = defaultdict(Rate)
        self._wire_start = (interface.sent_bytes, interface.received_bytes) if interface else (0, 0)
        self.received_bytes: Counter[str] = Counter()
        self.silent: dict[str, float] = {}

    def report(
        self, stamp_ns: int, frame_id: str, *, mode: str, own_weight: float, silent_after_s: float
    ) -> FusionStatus:
        """Return the message at an epoch.

        Args:
            stamp_ns: of the epoch.
            frame_id: of its header.
            mode: communication mode.
            own_weight: of the own information in the fusion.
            silent_after_s: age of a peer's newest packet from which it counts as silent [s].
        """
        peers = [self._peer(name, stamp_ns, silent_after_s) for name in sorted(self._fusion.inbox.peers)]
        self.silent = {peer.peer: peer.age_s for peer in peers if peer.silent and mode != "none"}
        sent, received = self._wire()
        return FusionStatus(
            header=header(stamp_ns, frame_id),
            vehicle=self._vehicle,
            mode=mode,
            own_weight=own_weight,
            packets_sent=self._outbox.packets_sent,
            packets_held_back=self._outbox.over_budget,
            bytes_sent=self._outbox.bytes_sent,
            sent_bytes_per_s=self._outbox.sent_bytes_per_s,
            recent_bytes_per_s=self._sent_rate.update(stamp_ns, self._outbox.bytes_sent),
            radio_interface=self._interface.name if self._interface else "",
            wire_sent_bytes=sent,
            wire_received_bytes=received,
            wire_sent_bytes_per_s=self._wire_rate.update(time.monotonic_ns(), sent),
            peers=peers,
        )

    def _wire(self) -> tuple[int, int]:
        """Return what the interface has sent and received since the start."""
        if self._interface is None:
            return 0, 0
        sent, received = self._wire_start
        return self._interface.sent_bytes - sent, self._interface.received_bytes - received

    def _peer(self, name: str, stamp_ns: int, silent_after_s: float) -> PeerLink:
        record = self._fusion.inbox.peers[name]
        newest = record.packets[-1] if record.packets else None
        age_s = (stamp_ns - newest.stamp_ns) / NS_PER_S if newest else 0.0
        return PeerLink(
            peer=name,
            session=newest.session if newest else 0,
            last_sequence=newest.sequence if newest else 0,
            packets_received=record.received,
            packets_used=len(record.used),
            received_bytes=self.received_bytes[name],
            received_bytes_per_s=self._received_rates[name].update(stamp_ns, self.received_bytes[name]),
            drop_reasons=list(record.dropped),
            drop_counts=list(record.dropped.values()),
            common_landmarks=record.common_landmarks,
            age_s=age_s,
            silent=age_s > silent_after_s,
        )
