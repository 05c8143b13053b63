# SPDX-License-Identifier: Apache-2.0
"""What leaves a vehicle: every packet passes here, and one that the byte budget has no room for is not sent.

A packet is self-contained, so nothing needs to be made good later: the next epoch's replaces the one held back.
"""

from uav_vslam.config import MODE_BUDGETS, FusionConfig
from uav_vslam.cooperation.budget import ByteBudget
from uav_vslam.slam.packet import NARROWBAND_PACKET_BYTES
from uav_vslam.types import NS_PER_S

SILENT_EPOCHS = 4  # narrowband: while no peer is heard, one epoch in so many has a packet; after so many that all have
SAVED_EPOCHS = 2.0  # of the budget at most: epochs are longer or shorter by a frame, and narrowband saves for a packet
WORTH_EPOCHS = 1.25  # of the budget that a narrowband packet waits for: of a small one a fifth is not about landmarks


class Outbox:
    """Counts what is sent and holds back what is too much.

    Attributes:
        packets_sent, bytes_sent: what was let through (payload).
        now_ns: stamp of the last epoch.
    """

    def __init__(self, config: FusionConfig) -> None:
        self.packets_sent = 0
        self.bytes_sent = 0
        self._first_ns: int | None = None  # stamp of the first epoch
        self._last_ns = 0
        self._last_received_ns = 0  # stamp of the newest packet of any peer
        self.now_ns = 0
        self._silent_epochs = 0
        self._granted: tuple[int, int, int] | None = None  # what the budget was made of
        self.configure(config)

    def configure(self, config: FusionConfig, *, copies: int = 1) -> None:
        """Go on with other settings; a budget that stays the same is not refilled, and counts go on.

        Args:
            config: mode, budget and epoch.
            copies: how often packets are expected to cross the radio: so much can be saved for.
        """
        self._mode, self._epoch_s, self._silent_after_s = config.mode, config.epoch_s, config.silent_after_s
        rate = config.budget_bytes_per_s or MODE_BUDGETS[config.mode]
        share = round(rate * config.epoch_s)
        self._worth_bytes = min(round(share * WORTH_EPOCHS), NARROWBAND_PACKET_BYTES)
        self._most_bytes = round(share * SAVED_EPOCHS) + self._worth_bytes * (copies - 1)
        granted = rate, self._most_bytes, share
        if granted != self._granted:
            self._granted, self._budget = granted, ByteBudget(*granted)

    @property
    def sent_bytes_per_s(self) -> float:
        """Mean payload rate from the first epoch to the one after the last packet [B/s]."""
        return self.bytes_sent / ((self._last_ns - (self._first_ns or 0)) / NS_PER_S + self._epoch_s)

    def on_packet(self, stamp_ns: int) -> None:
        """Note that a peer's packet of that stamp came; one from the future says that it was heard now, no more."""
        self._last_received_ns = max(self._last_received_ns, min(stamp_ns, self.now_ns))

    def should_send(self, stamp_ns: int, *, copies: int = 1) -> bool:
        """Tell, once an epoch, whether it has a packet, which crosses the radio so many times.

        In narrowband that is where enough is saved for a large one: two of three epochs, which tell more than three
        small packets. A radio that is full of packets has no room left for discovery, which then takes minutes: so once
        no peer has been heard for some epochs, most are left to it.
        """
        self.now_ns = stamp_ns
        if self._mode != "narrowband":
            return self._mode != "none"
        self._first_ns = stamp_ns if self._first_ns is None else self._first_ns
        unheard = stamp_ns - self._last_received_ns > self._silent_after_s * NS_PER_S
        self._silent_epochs = self._silent_epochs + 1 if unheard else 0
        to_discovery = self._silent_epochs > SILENT_EPOCHS and self._silent_epochs % SILENT_EPOCHS != 1
        return not to_discovery and self.available(stamp_ns) >= min(self._worth_bytes * copies, self._most_bytes)

    def available(self, now_ns: int) -> int:
        """Return how large a packet may be now [byte]."""
        return self._budget.available(now_ns)

    def try_reserve(self, stamp_ns: int, size_bytes: int) -> bool:
        """Tell whether a packet of that stamp and payload may be sent, and count it."""
        if not self._budget.spend(stamp_ns, size_bytes):
            return False
        self._first_ns = stamp_ns if self._first_ns is None else self._first_ns
        self._last_ns = stamp_ns
        self.packets_sent += 1
        self.bytes_sent += size_bytes
        return True
