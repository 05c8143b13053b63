# SPDX-License-Identifier: Apache-2.0
"""What a node's status depends on besides its inputs: whether it is still starting, and its recent drops."""

import time
from collections import Counter, deque
from collections.abc import Callable, Mapping

from rclpy.clock import Clock

from uav_vslam.monitor import DROPPED
from uav_vslam.types import NS_PER_S

START_S = 5.0  # of the ROS clock, for the first message of each input
LONGEST_START_S = 60.0  # of wall time, should the ROS clock not run
NO_CLOCK_S = 15.0  # of wall time, for somebody who publishes it: a busy computer starts a replay late
RECENT_REPORTS = 10
RECENT_S = 10.0  # of stamps


class Start:
    """The time in which first messages may still be on their way.

    It is time of the ROS clock: the clock of a replay stands at zero until all nodes are there, and goes at its pace.
    """

    def __init__(self, clock: Clock, published: Callable[[], bool]) -> None:
        """Start now; `published` returns whether somebody publishes the time of a clock that stands at zero."""
        self._clock, self._published = clock, published
        self._begin_ns, self._made_s = 0, time.monotonic()

    def lacks_clock(self) -> bool:
        """Return whether time stands still for want of somebody who publishes it."""
        waited_s = time.monotonic() - self._made_s
        return self._clock.now().nanoseconds == 0 and waited_s >= NO_CLOCK_S and not self._published()

    def lasts(self) -> bool:
        """Return whether the node is still starting."""
        now_ns = self._clock.now().nanoseconds
        self._begin_ns = self._begin_ns or now_ns
        waited_s = (now_ns - self._begin_ns) / NS_PER_S
        return not self.lacks_clock() and waited_s < START_S and time.monotonic() - self._made_s < LONGEST_START_S


class RecentDrops:
    """How many messages were dropped between the last reports, so that a past fault does not remain one."""

    def __init__(self) -> None:
        self._earlier = deque([Counter[str]()], maxlen=RECENT_REPORTS)

    def next_report(self, counts: Mapping[str, int]) -> str:
        """Return the drops since `RECENT_REPORTS` reports, "frame_lost 2, stamp 1"; empty if there were none."""
        drops = Counter({key.removeprefix(DROPPED): n for key, n in counts.items() if key.startswith(DROPPED)})
        recent = drops - self._earlier[0]
        self._earlier.append(drops)
        return ", ".join(f"{reason} {count}" for reason, count in sorted(recent.items()))


class RecentEvents:
    """How often something happened to the messages of the last `RECENT_S`, by their stamps."""

    def __init__(self) -> None:
        self._stamps_ns: deque[int] = deque()

    def count(self, stamp_ns: int, happened: int) -> int:
        """Add how often it happened to the newest message, and return how often to all recent ones.

        After a clock that was set back, those before do not count.
        """
        self._stamps_ns.extend([stamp_ns] * happened)
        recent = (one for one in self._stamps_ns if 0 <= stamp_ns - one < RECENT_S * NS_PER_S)
        self._stamps_ns = deque(recent)
        return len(self._stamps_ns)
