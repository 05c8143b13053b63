# SPDX-License-Identifier: Apache-2.0
"""Readings and image stamps from before the start state is known, and which start state fits them."""

from collections import deque

from uav_vslam.types import NS_PER_S, ImuSample

MAX_APART_S = 30.0  # of a start state and the newest reading; also how long what came before it is held


class StartupBuffer:
    """Holds what came last, over a span of time whatever the rates are."""

    def __init__(self, held_s: float = MAX_APART_S) -> None:
        """Hold what a start needs; that is what it is found from, at rest, or all that came since, where it is given.

        Args:
            held_s: span that is held [s]; one item from before it is too.
        """
        self._held_ns = held_s * NS_PER_S
        self._items: deque[ImuSample | int] = deque()
        self._newest_ns: int | None = None

    def add(self, item: ImuSample | int) -> None:
        """Add a reading or an image's stamp [ns]; what was too old when the one before came is forgotten."""
        while len(self._items) > 1 and _stamp_ns(self._items[1]) <= _stamp_ns(self._items[-1]) - self._held_ns:
            self._items.popleft()
        self._items.append(item)
        if isinstance(item, ImuSample):
            self._newest_ns = max(item.stamp_ns, self._newest_ns or item.stamp_ns)

    def take(self) -> list[ImuSample | int]:
        """Return all that is held, in order of arrival, and hold it no longer."""
        taken = list(self._items)
        self._items.clear()
        return taken

    def readings(self) -> list[ImuSample]:
        """Return the readings that are held."""
        return [item for item in self._items if isinstance(item, ImuSample)]

    def ahead_s(self, stamp_ns: int) -> float | None:
        """Return how far a start at this stamp lies after the newest reading [s]; None while none has come."""
        return None if self._newest_ns is None else (stamp_ns - self._newest_ns) / NS_PER_S


def _stamp_ns(item: ImuSample | int) -> int:
    return item.stamp_ns if isinstance(item, ImuSample) else item
