# SPDX-License-Identifier: Apache-2.0
"""Bandwidth limit of a vehicle: a token bucket without credit.

Reliable traffic above a link's rate collapses, so the excess must not reach the middleware at all.
"""

from uav_vslam.types import NS_PER_S


class ByteBudget:
    """Token bucket: fills at `rate_bytes_per_s` up to `burst_bytes`, starts with `initial_bytes`, or full.

    It counts in integer byte-nanoseconds, so that over any time t at most rate * t + burst is granted, to the byte.
    """

    def __init__(self, rate_bytes_per_s: int, burst_bytes: int, initial_bytes: int | None = None) -> None:
        if rate_bytes_per_s < 0 or burst_bytes < 0:
            raise ValueError(f"a budget of {rate_bytes_per_s} B/s, {burst_bytes} B at once: neither may be negative")
        self._rate = rate_bytes_per_s
        self._full = burst_bytes * NS_PER_S
        self._tokens = self._full if initial_bytes is None else min(initial_bytes * NS_PER_S, self._full)  # [byte ns]
        self._latest_ns: int | None = None

    def restart_clock(self) -> None:
        """Count time from the next stamp on, whatever it is; the tokens stay."""
        self._latest_ns = None

    def available(self, now_ns: int) -> int:
        """Return how many bytes may be sent now; a clock that steps back adds nothing."""
        if self._latest_ns is not None:
            added = max(now_ns - self._latest_ns, 0) * self._rate
            self._tokens = min(self._tokens + added, self._full)
        self._latest_ns = max(now_ns, self._latest_ns or now_ns)
        return self._tokens // NS_PER_S

    def spend(self, now_ns: int, size_bytes: int) -> bool:
        """Take a packet's bytes and return True, or take nothing and return False if they exceed the budget."""
        if size_bytes > self.available(now_ns):
            return False
        self._tokens -= size_bytes * NS_PER_S
        return True
