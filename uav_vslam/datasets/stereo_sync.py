# SPDX-License-Identifier: Apache-2.0
"""Pairs left and right images by stamp, for the bag reader and the ROS node."""

import statistics
from collections import deque
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from uav_vslam.geometry.stereo import SIDES
from uav_vslam.search import nearest
from uav_vslam.stamps import RUN_LENGTH

T = TypeVar("T")

LARGEST_TOLERANCE_NS = 20_000_000  # of the default: cameras farther apart than this are not synchronised
EARLY_TOLERANCE_NS = 5_000_000  # of the default while the period is unknown: half of it at 100 Hz
WAITING = 10  # images of one camera; then the oldest is dropped
LATE_NS = 2_000_000_000  # an older image is no late one, but of another clock
NOTABLE_OFFSET_NS = 500_000  # at 20 m/s over farmland, a pair so far apart is moved by 10 mm against its baseline
PERIODS = 3, 20  # how many determine the frame period: at least, and of the last so many


def nearest_offsets_ns(left_ns: NDArray[np.int64], right_ns: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return (N,) the nearest right stamp minus each of (N,) left ones, in any order; empty without right ones [ns]."""
    right_ns = np.unique(right_ns)
    if len(right_ns) == 0:
        return np.zeros(0, np.int64)
    return np.asarray(right_ns[nearest(left_ns, right_ns)] - left_ns)


@dataclass(frozen=True, slots=True)
class StereoPair(Generic[T]):
    """Two images that belong together.

    Attributes:
        stamp_ns: the left image's stamp [ns].
        left, right: the items added.
    """

    stamp_ns: int
    left: T
    right: T


class PairTolerance:
    """Largest difference between the stamps of a pair: as set, or half of the median period of the left images.

    Attributes:
        ns: its value after the images so far [ns].
    """

    def __init__(self, set_ns: int) -> None:
        """Set up; 0 for the default, which is at most `LARGEST_TOLERANCE_NS`."""
        self._is_set, self.ns = set_ns > 0, set_ns or EARLY_TOLERANCE_NS
        self._periods_ns: deque[int] = deque(maxlen=PERIODS[1])
        self._newest_ns: int | None = None

    def add_left(self, stamp_ns: int) -> None:
        """Count the period from the previous left image to this one, unless the clock jumped in between."""
        if self._newest_ns is not None and stamp_ns > self._newest_ns:
            self._periods_ns.append(stamp_ns - self._newest_ns)
            if len(self._periods_ns) >= PERIODS[0] and not self._is_set:
                self.ns = min(LARGEST_TOLERANCE_NS, round(statistics.median(self._periods_ns) / 2))
        self._newest_ns = stamp_ns


class StereoPairer(Generic[T]):
    """Holds images until their partner arrives; those that can have none are dropped and counted.

    Stamps that jump, ahead or back, pair up as others do: what to do about them is decided where they meet the IMU's. A
    late or repeated image is dropped, unless several in a row show that the clock was set back a little.

    Attributes:
        dropped: images without a partner.
        offset_ns: right stamp minus left stamp of the newest pair [ns].
    """

    def __init__(self, *, tolerance_ns: int = 0) -> None:
        """Set up.

        Args:
            tolerance_ns: largest difference between the stamps of a pair [ns]; 0 for that of `PairTolerance`.
        """
        self._tolerance = PairTolerance(tolerance_ns)
        self.offset_ns = 0
        self._waiting: dict[str, deque[tuple[int, T]]] = {side: deque() for side in SIDES}
        self._newest, self._late = dict.fromkeys(SIDES, -1), dict.fromkeys(SIDES, 0)
        self.dropped = 0

    @property
    def tolerance_ns(self) -> int:
        """Largest difference between the stamps of a pair, after the images so far [ns]."""
        return self._tolerance.ns

    def add(self, side: str, stamp_ns: int, item: T) -> StereoPair[T] | None:
        """Add an image of the "left" or "right" camera; return the completed pair, if any."""
        if not self._is_next(side, stamp_ns):
            return None
        own, other = self._waiting[side], self._waiting["right" if side == "left" else "left"]
        partner = self._take_partner(other, stamp_ns)
        if partner is None:
            self._wait(own, stamp_ns, item)
            return None
        self._drop(own, len(own))
        left, right = ((stamp_ns, item), partner) if side == "left" else (partner, (stamp_ns, item))
        self.offset_ns = right[0] - left[0]
        return StereoPair(left[0], left[1], right[1])

    def _is_next(self, side: str, stamp_ns: int) -> bool:
        behind_ns = self._newest[side] - stamp_ns
        self._late[side] = self._late[side] + 1 if 0 <= behind_ns <= LATE_NS else 0
        if 0 < self._late[side] < RUN_LENGTH or behind_ns == 0:
            self.dropped += 1
            return False
        self._late[side] = 0
        if side == "left":
            self._tolerance.add_left(stamp_ns)
        self._newest[side] = stamp_ns
        return True

    def _take_partner(self, waiting: deque[tuple[int, T]], stamp_ns: int) -> tuple[int, T] | None:
        """Remove and return the nearest waiting image within the tolerance; those that came before are dropped."""
        near = [k for k, entry in enumerate(waiting) if abs(entry[0] - stamp_ns) <= self.tolerance_ns]
        if not near:
            return None
        self._drop(waiting, min(near, key=lambda k: abs(waiting[k][0] - stamp_ns)))
        return waiting.popleft()

    def _wait(self, waiting: deque[tuple[int, T]], stamp_ns: int, item: T) -> None:
        waiting.append((stamp_ns, item))
        if len(waiting) > WAITING:
            waiting.popleft()
            self.dropped += 1

    def _drop(self, waiting: deque[tuple[int, T]], count: int) -> None:
        for _ in range(count):
            waiting.popleft()
        self.dropped += count
