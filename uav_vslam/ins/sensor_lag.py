# SPDX-License-Identifier: Apache-2.0
"""Tells the clock of one sensor that was set by a little from readings or images that were lost.

Both leave a step in the stamps of one stream. The lag is how far the newest reading is ahead of an image when the image
arrives. It follows the step if the clock was set, and stays if messages were lost; on a machine that is behind it
changes without a step.
"""

import statistics
from collections import deque

from uav_vslam.types import NS_PER_S

IMU, IMAGES = "IMU", "image"  # streams of the time line
LEAST_NS = NS_PER_S * 3 // 100  # smaller steps are not looked at,
MOST_NS = 5 * NS_PER_S  # larger ones are off the time line anyway
FOLLOWED = 1.0 / 3.0  # of a step, by which the lag may miss it
KEPT, ENOUGH = 20, 5  # lags and steps that the usual ones are taken from


class SensorLag:
    """The usual lag between two streams, and steps that it may follow.

    Attributes:
        steps_ns: of the streams whose clock may have been set, by name [ns].
        followed: images since, at whose arrival the lag had followed.
    """

    def __init__(self) -> None:
        self._newest_ns: dict[str, int] = {}  # as arrived
        self._spacings_ns: dict[str, deque[int]] = {name: deque(maxlen=KEPT) for name in (IMU, IMAGES)}
        self._lags_ns: deque[int] = deque(maxlen=KEPT)
        self._latest_ns: list[int] = []  # lags since the last reading: they are no usual ones if the next is late
        self.steps_ns: dict[str, int] = {}
        self.followed = 0

    def add(self, name: str, stamp_ns: int, trusted_ns: int | None) -> None:
        """Add the stamp of a message that has arrived.

        Args:
            name: stream.
            stamp_ns: its stamp [ns].
            trusted_ns: newest stamp of the stream that is on the time line [ns].
        """
        before_ns, self._newest_ns[name] = self._newest_ns.get(name), stamp_ns
        if before_ns is not None and self._spacings_ns[name] and len(self._lags_ns) >= ENOUGH:
            self._look_for_step(name, stamp_ns - before_ns, None if trusted_ns is None else stamp_ns - trusted_ns)
        if before_ns is not None and stamp_ns > before_ns:
            self._spacings_ns[name].append(stamp_ns - before_ns)
        if name == IMU:
            self._lags_ns.extend(() if IMU in self.steps_ns else self._latest_ns)
            self._latest_ns.clear()
        if name == IMAGES and IMU in self._newest_ns:
            self._look_at_lag(self._newest_ns[IMU] - stamp_ns)

    def trust(self) -> None:
        """Forget the steps."""
        self.steps_ns.clear()
        self.followed = 0

    def _look_for_step(self, name: str, spacing_ns: int, ahead_ns: int | None) -> None:
        usual_ns = round(statistics.median(self._spacings_ns[name]))
        step_ns = spacing_ns - usual_ns
        if abs(step_ns) <= LEAST_NS:
            return
        continues = ahead_ns is not None and 0 < ahead_ns <= usual_ns + LEAST_NS
        if abs(step_ns) > MOST_NS or (name in self.steps_ns and continues):  # a stray stamp came in between
            self.steps_ns.pop(name, None)
        else:
            self.steps_ns[name] = self.steps_ns.get(name, 0) + step_ns

    def _look_at_lag(self, lag_ns: int) -> None:
        """Forget the steps unless the lag has followed them; one that follows by a part is that of a machine behind."""
        if len(self._lags_ns) < ENOUGH:
            self._latest_ns.append(lag_ns)
            return
        change_ns = lag_ns - statistics.median(self._lags_ns)
        expected_ns = self.steps_ns.get(IMU, 0) - self.steps_ns.get(IMAGES, 0)
        scatter_ns = max(self._lags_ns) - min(self._lags_ns)
        if abs(expected_ns) > max(LEAST_NS, scatter_ns) and abs(change_ns - expected_ns) < FOLLOWED * abs(expected_ns):
            self.followed += 1
            return
        self.trust()
        if abs(change_ns) <= MOST_NS:
            self._latest_ns.append(lag_ns)
