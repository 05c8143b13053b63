# SPDX-License-Identifier: Apache-2.0
"""How many bytes a vehicle may still send: a token bucket that never goes into debt.

Reliable traffic above a link's rate collapses, so what is too much must not reach the middleware at all.
"""

from uav_vslam.types import NS_PER_S


class ByteBudget:
    """Earns `rate_bytes_per_s` up to `burst_bytes`, and begins with `saved_bytes`, or full.

    It counts in whole byte-nanoseconds, so that over any time t at most rate * t + burst is granted, to the byte.
    """

    def __init__(self, rate_bytes_per_s: int, burst_bytes: int, saved_bytes: int | None = None) -> None:
        if rate_bytes_per_s < 0 or burst_bytes < 0:
            raise ValueError(f"a budget of {rate_bytes_per_s} B/s, {burst_bytes} B at once: neither may be negative")
        self._rate = rate_bytes_per_s
        self._full = burst_bytes * NS_PER_S
        self._saved = self._full if saved_bytes is None else min(saved_bytes * NS_PER_S, self._full)  # [byte ns]
        self._latest_ns: int | None = None

    def available(self, now_ns: int) -> int:
        """Return how many bytes may leave now; a clock that steps back earns nothing."""
        if self._latest_ns is not None:
            earned = max(now_ns - self._latest_ns, 0) * self._rate
            self._saved = min(self._saved + earned, self._full)
        self._latest_ns = max(now_ns, self._latest_ns or now_ns)
        return self._saved // NS_PER_S

    def spend(self, now_ns: int, size_bytes: int) -> bool:
        """Take what a packet costs and return True, or take nothing and return False where it does not fit."""
        if size_bytes > self.available(now_ns):
            return False
        self._saved -= size_bytes * NS_PER_S
        return True
