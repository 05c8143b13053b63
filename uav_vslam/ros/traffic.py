# SPDX-License-Identifier: Apache-2.0
"""Traffic: rates of byte counters, and the kernel's counters of a network interface."""

import contextlib
from collections import Counter, deque
from dataclasses import dataclass, field
from pathlib import Path

from uav_vslam.errors import ConfigError
from uav_vslam.types import NS_PER_S

WINDOW_S = 10.0
INTERFACES = Path("/sys/class/net")
NO_LINK = {"down", "lowerlayerdown", "notpresent", "dormant"}  # of operstate; drivers that know none say "unknown"


@dataclass(slots=True)
class Rate:
    """Mean rate of a counter over the last seconds."""

    window_s: float = WINDOW_S
    _samples: deque[tuple[int, int]] = field(default_factory=deque)

    def update(self, now_ns: int, total: int) -> float:
        """Add a value of the counter and return its rate since the last value that is at least a window old [1/s]."""
        if self._samples and now_ns < self._samples[-1][0]:
            self._samples.clear()  # a clock that was set back
        self._samples.append((now_ns, total))
        while len(self._samples) > 2 and now_ns - self._samples[1][0] >= self.window_s * NS_PER_S:
            self._samples.popleft()
        begin_ns, begin = self._samples[0]
        return (total - begin) / ((now_ns - begin_ns) / NS_PER_S) if now_ns > begin_ns else 0.0


@dataclass(slots=True)
class Interface:
    """A network interface; the kernel counts all of its traffic: discovery, headers, and other programs' too.

    One that is unplugged is down, and its counters stay where they were; plugged in again, they go on from there.

    Attributes:
        name: as `ip link` shows it.
    """

    name: str
    _last: Counter[str] = field(default_factory=Counter)  # as the kernel had it
    _before: Counter[str] = field(default_factory=Counter)  # what it had counted before it restarted

    def __post_init__(self) -> None:
        if "/" in self.name or not (INTERFACES / self.name).is_dir():
            known = ", ".join(sorted(path.name for path in INTERFACES.iterdir()))
            raise ConfigError(f"radio_interface = {self.name!r} is no network interface of this host ({known})")

    @property
    def is_down(self) -> bool:
        """Whether it carries nothing: unplugged, switched off, or without a link."""
        try:
            return (INTERFACES / self.name / "operstate").read_text().strip() in NO_LINK
        except OSError:
            return True

    @property
    def sent_bytes(self) -> int:
        """Sent since the host started, link headers included."""
        return self._read("tx_bytes")

    @property
    def received_bytes(self) -> int:
        """Received since the host started, link headers included."""
        return self._read("rx_bytes")

    def _read(self, counter: str) -> int:
        now = self._last[counter]
        with contextlib.suppress(OSError):
            now = int((INTERFACES / self.name / "statistics" / counter).read_text())
        if now < self._last[counter]:
            self._before[counter] += self._last[counter]
        self._last[counter] = now
        return self._before[counter] + now
