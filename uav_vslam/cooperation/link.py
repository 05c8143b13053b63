# SPDX-License-Identifier: Apache-2.0
"""One direction of an emulated radio link: rate, queue, delay, jitter, loss, duplication and blackouts.

The order is that of a real radio: a packet waits in the sender's queue until the rate permits, and may then be lost,
delayed or duplicated on air. The same seed and the same calls give the same packets.
"""

import heapq
import zlib
from collections import Counter, deque
from dataclasses import replace
from typing import Generic, TypeVar

import numpy as np

from uav_vslam.config import LinkConfig
from uav_vslam.types import NS_PER_S

Item = TypeVar("Item")

SET_BACK_NS = NS_PER_S  # a clock that goes back further was set, not adjusted


class Link(Generic[Item]):
    """Carries items of a stated size from one sender to one receiver.

    Attributes:
        packets, size_bytes: how many packets and bytes were offered, queue_dropped, blacked_out, lost, duplicated and
            delivered. offered + duplicated = queue_dropped + blacked_out + lost + delivered + in flight.
    """

    def __init__(self, config: LinkConfig) -> None:
        self._config = config
        self._rng = np.random.default_rng(config.seed)
        self._start_ns: int | None = None
        self._now_ns = 0  # at the last call
        self._free_ns = 0  # when the last packet has left the queue
        self._tokens = float(config.burst_bytes)  # at that time [byte]
        self._queue: deque[tuple[int, int]] = deque()  # (when it has left, size) of the packets not yet out
        self._air: list[tuple[int, int, int, Item]] = []  # heap of (arrival, serial, size, item)
        self._serial = 0
        self.packets: Counter[str] = Counter()
        self.size_bytes: Counter[str] = Counter()

    @property
    def queued_bytes(self) -> int:
        """Size of the queue at the last `send`."""
        return sum(size for _, size in self._queue)

    def send(self, now_ns: int, size_bytes: int, item: Item) -> None:
        """Offer a packet."""
        self._follow_clock(now_ns)
        if self._start_ns is None:
            self._start_ns = self._free_ns = now_ns
        self._count("offered", size_bytes)
        lost, duplicated, *jitter = self._rng.random(4)  # always four draws: one packet's fate does not affect the next
        leaves_ns = self._enqueue(now_ns, size_bytes)
        if leaves_ns is None:
            self._count("queue_dropped", size_bytes)
        elif self._is_dark((leaves_ns - self._start_ns) / NS_PER_S):
            self._count("blacked_out", size_bytes)
        elif lost < self._config.loss:
            self._count("lost", size_bytes)
        else:
            twice = duplicated < self._config.duplication
            if twice:
                self._count("duplicated", size_bytes)
            for share in jitter[: 1 + twice]:
                flight_s = self._config.delay_s + share * self._config.jitter_s
                self._serial += 1
                heapq.heappush(self._air, (leaves_ns + round(flight_s * NS_PER_S), self._serial, size_bytes, item))

    def receive(self, now_ns: int) -> list[Item]:
        """Return what has arrived since the last call, in the order of arrival."""
        self._follow_clock(now_ns)
        arrived = []
        while self._air and self._air[0][0] <= now_ns:
            _, _, size_bytes, item = heapq.heappop(self._air)
            self._count("delivered", size_bytes)
            arrived.append(item)
        return arrived

    def _follow_clock(self, now_ns: int) -> None:
        """Begin again where the clock was set back: what is under way would wait for the old time, and is lost."""
        if now_ns < self._now_ns - SET_BACK_NS:
            for _, _, size_bytes, _ in self._air:
                self._count("lost", size_bytes)
            self._air.clear()
            self._queue.clear()
            self._start_ns, self._tokens = None, float(self._config.burst_bytes)
        self._now_ns = now_ns

    def _enqueue(self, now_ns: int, size_bytes: int) -> int | None:
        """Return when the packet's last byte has left, None if the queue is full."""
        rate = self._config.rate_bytes_per_s
        if rate == 0:
            return now_ns
        while self._queue and self._queue[0][0] <= now_ns:
            self._queue.popleft()
        begin_ns = max(now_ns, self._free_ns)
        added = (begin_ns - self._free_ns) / NS_PER_S * rate
        tokens = min(self._tokens + added, float(self._config.burst_bytes))
        wait_s = max(size_bytes - tokens, 0.0) / rate
        leaves_ns = begin_ns + int(np.ceil(wait_s * NS_PER_S))
        if leaves_ns > now_ns:
            if self.queued_bytes + size_bytes > self._config.queue_bytes:
                return None
            self._queue.append((leaves_ns, size_bytes))
        self._free_ns, self._tokens = leaves_ns, max(tokens - size_bytes, 0.0)
        return leaves_ns

    def _is_dark(self, since_start_s: float) -> bool:
        return any(start <= since_start_s < end for start, end in self._config.blackout_spans)

    def _count(self, what: str, size_bytes: int) -> None:
        self.packets[what] += 1
        self.size_bytes[what] += size_bytes


def link_between(config: LinkConfig, sender: str, receiver: str) -> Link[Item]:
    """Make the link of one direction; each direction has its own random sequence."""
    return Link(replace(config, seed=zlib.crc32(f"{sender}>{receiver} {config.seed}".encode())))
