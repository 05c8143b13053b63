# SPDX-License-Identifier: Apache-2.0
"""An IMU whose gyroscope and accelerometer give their readings apart, at rates and stamps of their own."""

from collections import deque
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from uav_vslam.types import NS_PER_S

Array = NDArray[np.float64]
T = TypeVar("T")

LONGEST_GAP_NS = NS_PER_S // 10  # between two specific forces: what is in between is not known
LATE_NS = NS_PER_S // 2  # a stamp this far back is of a clock that was set


class SplitImu(Generic[T]):
    """Gives each reading of the gyroscope the specific force at its stamp, linear between those measured.

    A reading waits for the first specific force at or after it. T is what a reading of the gyroscope is.

    Attributes:
        unmatched: readings without a specific force on either side soon enough; they are left out.
    """

    def __init__(self) -> None:
        self.unmatched = 0
        self._forces: deque[tuple[int, Array]] = deque()
        self._waiting: deque[tuple[int, T]] = deque()

    def add_gyro(self, stamp_ns: int, reading: T) -> list[tuple[T, Array]]:
        """Add a reading of the gyroscope; return those that are complete, each with its (3,) specific force."""
        self._waiting.append((stamp_ns, reading))
        return self._complete()

    def add_accel(self, stamp_ns: int, force: Array) -> list[tuple[T, Array]]:
        """Add a (3,) specific force; return the readings that it completes, each with its own."""
        if self._forces and stamp_ns <= self._forces[-1][0]:
            if stamp_ns >= self._forces[-1][0] - LATE_NS:
                return []  # recorded late or twice
            self.unmatched += len(self._waiting)
            self._waiting.clear()
            self._forces.clear()
        self._forces.append((stamp_ns, force))
        return self._complete()

    def _complete(self) -> list[tuple[T, Array]]:
        complete = []
        while self._waiting and self._forces and self._forces[-1][0] >= self._waiting[0][0]:
            stamp_ns, reading = self._waiting.popleft()
            force = self._force(stamp_ns)
            if force is None:
                self.unmatched += 1
            else:
                complete.append((reading, force))
        return complete

    def _force(self, stamp_ns: int) -> Array | None:
        """Return the specific force at a stamp that is not after the newest one; None if it is not known."""
        while len(self._forces) > 1 and self._forces[1][0] <= stamp_ns:
            self._forces.popleft()
        before_ns, before = self._forces[0]
        if before_ns == stamp_ns:
            return before
        if before_ns > stamp_ns or self._forces[1][0] - before_ns > LONGEST_GAP_NS:
            return None
        after_ns, after = self._forces[1]
        return before + (after - before) * ((stamp_ns - before_ns) / (after_ns - before_ns))
