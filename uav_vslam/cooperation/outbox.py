# SPDX-License-Identifier: Apache-2.0
"""The byte budget of a vehicle: every packet is charged to it, and one that exceeds it is not sent.

A packet is self-contained, so none is resent: the next epoch's replaces the one held back.

The budget counts by the stamps of the own epochs. While none come, as in a vehicle that only relays or whose back end
has stopped, it counts on by the transport's clock; no peer's stamp can fill it.
"""

import time
from collections.abc import Callable

from uav_vslam.config import MODE_BUDGETS, FusionConfig
from uav_vslam.cooperation.budget import ByteBudget
from uav_vslam.cooperation.inbox import NO_EPOCHS_S
from uav_vslam.slam.packet import NARROWBAND_PACKET_BYTES
from uav_vslam.types import NS_PER_S

SILENT_EPOCHS = 4  # narrowband: after so many epochs without a peer, only one epoch in so many sends a packet
SAVED_EPOCHS = 2.0  # limit of the unspent budget: epoch lengths vary by a frame, and narrowband saves for a packet
WORTH_EPOCHS = 1.25  # budget that a narrowband packet waits for: a fifth of a small packet is overhead


class Outbox:
    """Counts what is sent and holds back what exceeds the budget.

    Attributes:
        packets_sent, bytes_sent: accepted packets and their payload.
        now_ns: stamp of the last epoch; 0 before the first.
    """

    def __init__(self, config: FusionConfig, clock: Callable[[], int] = time.monotonic_ns) -> None:
        """Start with the settings, and a clock that goes on without own epochs [ns]."""
        self._clock = clock
        self.packets_sent = 0
        self.bytes_sent = 0
        self._first_ns: int | None = None  # stamp of the first epoch, or packet relayed before
        self._last_ns: int | None = None  # of the last packet
        self._flown_ns = 0  # before the clock was set
        self._last_received_ns = 0  # own time of the last packet of any peer
        self.now_ns = 0
        self._begin_clock()
        self._silent_epochs = 0
        self._granted: tuple[int, int, int] | None = None  # arguments of the current budget
        self.configure(config)

    def configure(self, config: FusionConfig, *, copies: int = 1) -> None:
        """Change the settings; an unchanged budget is not refilled, and the counts continue.

        Args:
            config: mode, budget and epoch.
            copies: expected transmissions of each packet, all of which can be saved for.
        """
        self._mode, self._epoch_s, self._silent_after_s = config.mode, config.epoch_s, config.silent_after_s
        rate = config.budget_bytes_per_s or MODE_BUDGETS[config.mode]
        share = round(rate * config.epoch_s)
        self._worth_bytes = min(round(share * WORTH_EPOCHS), NARROWBAND_PACKET_BYTES)
        self._most_bytes = round(share * SAVED_EPOCHS) + self._worth_bytes * (copies - 1)
        granted = rate, self._most_bytes, share
        if granted != self._granted:
            self._granted, self._budget = granted, ByteBudget(*granted)

    def restart_clock(self) -> None:
        """Go on by stamps that may be older; the budget is not refilled."""
        self._follow_another_clock()
        self._last_received_ns = self.now_ns = 0
        self._begin_clock()

    def _begin_clock(self) -> None:
        self._has_epoch = False
        self._clock_ns = self._clock()  # at the last epoch; while there is none, at the beginning

    def _follow_another_clock(self) -> None:
        self._flown_ns = self._flown()
        self._first_ns = self._last_ns = None
        self._budget.restart_clock()

    @property
    def sent_bytes_per_s(self) -> float:
        """Mean payload rate from the first epoch, or relayed packet, to the epoch after the last packet [B/s]."""
        return self.bytes_sent / (self._flown() / NS_PER_S + self._epoch_s)

    def _flown(self) -> int:
        """Return the time from the first epoch to the last packet, on all clocks [ns]."""
        if self._first_ns is None or self._last_ns is None:
            return self._flown_ns
        return self._flown_ns + self._last_ns - self._first_ns

    def on_packet(self) -> None:
        """Record the arrival of a peer's packet; its stamp is that of another clock."""
        self._last_received_ns = self.now_ns

    def should_send(self, stamp_ns: int, *, copies: int = 1) -> bool:
        """Return, once an epoch, whether to send a packet, which crosses the radio `copies` times.

        Narrowband saves for a large one, in two of three epochs: two large ones hold more than three small ones.
        A radio full of packets leaves no room for discovery, which then takes minutes: once no peer has been received
        for some epochs, most are left to discovery.
        """
        self._count_epoch(stamp_ns)
        if self._mode != "narrowband":
            return self._mode != "none"
        self._first_ns = stamp_ns if self._first_ns is None else self._first_ns
        silent = stamp_ns - self._last_received_ns > self._silent_after_s * NS_PER_S
        self._silent_epochs = self._silent_epochs + 1 if silent else 0
        to_discovery = self._silent_epochs > SILENT_EPOCHS and self._silent_epochs % SILENT_EPOCHS != 1
        return not to_discovery and self.available(stamp_ns) >= min(self._worth_bytes * copies, self._most_bytes)

    def _count_epoch(self, stamp_ns: int) -> None:
        if not self._has_epoch:  # the stamps begin anywhere: they do not continue the time before
            self._follow_another_clock()
        self._has_epoch, self.now_ns, self._clock_ns = True, stamp_ns, self._clock()

    def budget_ns(self) -> int:
        """Return the time by which the budget counts now: the last epoch's stamp, later once none have come [ns]."""
        waited_ns = self._clock() - self._clock_ns - round(NO_EPOCHS_S * NS_PER_S) * self._has_epoch
        return self.now_ns + max(waited_ns, 0)

    def available(self, now_ns: int) -> int:
        """Return the largest payload allowed now [byte]."""
        return self._budget.available(now_ns)

    def try_reserve(self, stamp_ns: int, size_bytes: int) -> bool:
        """Charge a packet of that stamp and payload; return False, without charging, if it exceeds the budget."""
        if not self._budget.spend(stamp_ns, size_bytes):
            return False
        self._first_ns = stamp_ns if self._first_ns is None else self._first_ns
        self._last_ns = stamp_ns
        self.packets_sent += 1
        self.bytes_sent += size_bytes
        return True
