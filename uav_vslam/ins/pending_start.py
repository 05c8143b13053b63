# SPDX-License-Identifier: Apache-2.0
"""A start state that waits for the readings around its stamp."""

from collections.abc import Callable
from dataclasses import dataclass

from uav_vslam.ins.preintegration import MAX_GAP_S
from uav_vslam.ins.startup_buffer import MAX_APART_S, StartupBuffer
from uav_vslam.types import NavEstimate


@dataclass(frozen=True, slots=True)
class Refusal:
    """Why a start state is of no use.

    Attributes:
        reason: short key under which the drop is counted.
        text: what is wrong with it.
    """

    reason: str
    text: str


class PendingStart:
    """Holds the newest start state until readings are near its stamp, then lets the vehicle start there or refuses it.

    The state is given from outside, or is the newest estimate of a back end that is in flight already.

    Attributes:
        frame: name of the newest one's body frame.
    """

    def __init__(self, buffer: StartupBuffer) -> None:
        """Decide by the readings in a buffer, which others fill."""
        self._buffer = buffer
        self._given: NavEstimate | None = None
        self.frame = ""
        self._resumed_ns = -1  # of the back end's estimate

    def give(self, start: NavEstimate, frame: str) -> None:
        """Take a start state, unless the back end's is newer: latched, the take-off state comes in flight too."""
        if start.state.stamp_ns >= self._resumed_ns:
            self._given, self.frame = start, frame

    def resume(self, estimate: NavEstimate, frame: str) -> None:
        """Take the estimate of a back end in flight, which makes no newer one without increments."""
        self._given, self.frame, self._resumed_ns = estimate, frame, estimate.state.stamp_ns

    @property
    def ahead_s(self) -> float | None:
        """Time from the newest reading to the state that waits [s]; None if either is missing."""
        return None if self._given is None else self._buffer.ahead_s(self._given.state.stamp_ns)

    def confirmed(self, conflict: Callable[[str], str]) -> NavEstimate | Refusal | None:
        """Return the start state once readings are near its stamp, or why it is refused; None while it has to wait.

        Args:
            conflict: returns why a frame is not that of the body, empty if it is.
        """
        if self._given is None or (ahead_s := self.ahead_s) is None or ahead_s > MAX_APART_S:
            return None
        start, self._given = self._given, None
        stamp_ns = start.state.stamp_ns
        if text := self._buffer.refusal(stamp_ns, in_flight=stamp_ns == self._resumed_ns):
            return Refusal("start_stamp", f"initial_state is stamped {stamp_ns} ns, {text}")
        if text := conflict(self.frame):
            return Refusal("start_frame", f"initial_state {text}")
        return start

    def is_resumed(self, stamp_ns: int) -> bool:
        """Return whether a start at this stamp is the back end's estimate from before a time without readings."""
        return stamp_ns == self._resumed_ns and self._buffer.uncovered_s(stamp_ns) > MAX_GAP_S
