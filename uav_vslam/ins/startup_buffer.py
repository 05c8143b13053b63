# SPDX-License-Identifier: Apache-2.0
"""Buffer for readings and image stamps until the start state is known."""

from collections import deque
from collections.abc import Iterable

from uav_vslam.types import NS_PER_S, ImuSample

MAX_APART_S = 30.0  # largest time between start state and newest reading; also the buffered span
MAX_UNCOVERED_S = 2.0  # largest time from a start state to the first reading: the motion in between is unknown


class StartupBuffer:
    """Holds the latest items over a span of time, independent of their rates."""

    def __init__(self, held_s: float = MAX_APART_S) -> None:
        """Hold the input of a static alignment, or everything since a given start state.

        Args:
            held_s: buffered span [s], plus one item before it.
        """
        self._held_ns = held_s * NS_PER_S
        self._items: deque[ImuSample | int] = deque()
        self._newest_ns: int | None = None
        self._has_image = False

    def add(self, item: ImuSample | int) -> None:
        """Add a reading or an image's stamp [ns]; items already too old at the previous one are dropped."""
        while len(self._items) > 1 and _stamp_ns(self._items[1]) <= _stamp_ns(self._items[-1]) - self._held_ns:
            self._items.popleft()
        self._items.append(item)
        if isinstance(item, ImuSample):
            self._newest_ns = max(item.stamp_ns, self._newest_ns or item.stamp_ns)
        else:
            self._has_image = True

    def take(self, *, from_first_reading: bool = False) -> list[ImuSample | int]:
        """Return and remove all items, in order of arrival; images from before the first reading may be left out."""
        first_ns = self._first_reading_ns(0) if from_first_reading else 0
        taken = [item for item in self._items if _stamp_ns(item) >= first_ns]
        self._items.clear()
        return taken

    def readings(self) -> list[ImuSample]:
        """Return the buffered readings."""
        return [item for item in self._items if isinstance(item, ImuSample)]

    def at_rest(self) -> list[ImuSample]:
        """Return the readings once they last the buffered span and an image has come; before that, none.

        A start long before the first image would be worth little by then: its motion is the IMU's alone.
        """
        readings = self.readings() if self._has_image else []
        lasts = len(readings) > 1 and readings[-1].stamp_ns - readings[0].stamp_ns >= self._held_ns
        return readings if lasts else []

    def ahead_s(self, stamp_ns: int) -> float | None:
        """Return the time from the newest reading to a start at this stamp [s]; None without readings."""
        return None if self._newest_ns is None else (stamp_ns - self._newest_ns) / NS_PER_S

    def uncovered_s(self, stamp_ns: int) -> float:
        """Return the time from a start at this stamp to the first reading that is buffered [s]."""
        return (self._first_reading_ns(stamp_ns) - stamp_ns) / NS_PER_S

    def refusal(self, stamp_ns: int, *, in_flight: bool = False) -> str:
        """Return why a start at this stamp is of no use; empty if it is of use, or without readings.

        Args:
            stamp_ns: of the start state [ns].
            in_flight: the start is the back end's newest estimate. It makes no newer one without our increments, so
                an unknown motion since is accepted.
        """
        ahead_s, uncovered_s = self.ahead_s(stamp_ns), self.uncovered_s(stamp_ns)
        if ahead_s is not None and ahead_s < -MAX_APART_S:
            return (
                f"{-ahead_s:.1f} s before the newest IMU sample, more than {MAX_APART_S:g} s; stamp it with its time "
                "of validity"
            )
        if uncovered_s > MAX_UNCOVERED_S and not in_flight:
            return (
                f"{uncovered_s:.1f} s before the first IMU sample received, more than {MAX_UNCOVERED_S:g} s: the "
                "motion since is unknown; publish a newer one, or start with the vehicle at rest (start.method: static)"
            )
        return ""

    def _first_reading_ns(self, otherwise_ns: int) -> int:
        """Return the stamp of the first reading that is buffered, or another one if there is none [ns]."""
        return next((item.stamp_ns for item in self._items if isinstance(item, ImuSample)), otherwise_ns)


def first_rest(items: Iterable[ImuSample | int], rest_s: float) -> list[ImuSample]:
    """Return the readings to align by, see `at_rest`, of a recording's readings and image stamps [ns]; else the newest.

    Args:
        items: in order of arrival.
        rest_s: how long the readings last [s].
    """
    buffer = StartupBuffer(rest_s)
    for item in items:
        buffer.add(item)
        if readings := buffer.at_rest():
            return readings
    return buffer.readings()


def _stamp_ns(item: ImuSample | int) -> int:
    return item.stamp_ns if isinstance(item, ImuSample) else item
