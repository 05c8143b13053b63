# SPDX-License-Identifier: Apache-2.0
"""The time line of a vehicle's sensors, and what a jump of their clock does to an estimate (`input.on_time_jump`)."""

import dataclasses
from collections import deque
from typing import Any

from uav_vslam.config import ImuConfig
from uav_vslam.ins.increments import unknown_motion_since
from uav_vslam.ins.propagation import transition
from uav_vslam.ins.sensor_lag import IMAGES, IMU, LEAST_NS, SensorLag
from uav_vslam.stamps import (
    FAULT_S,
    IMAGE_TIME_JUMP_S,
    IMU_TIME_JUMP_S,
    RUN_LENGTH,
    RUN_S,
    Admitted,
    TimeJump,
    TimeLine,
)
from uav_vslam.types import NS_PER_S, NavEstimate

SURE = 2  # images whose lag has followed a step, before it counts as that of a clock
MOST_BRIDGED_S = 30.0  # of a jump ahead; beyond it an estimate is worth no more than a new start
EARLY_STARTS = 4  # start states remembered that belong to no known time line
MOST_ELAPSED_S = 60.0  # flown unseen, however far a clock was set


class SensorTimeLine(TimeLine[Any]):
    """The time line of readings and frames, which must agree to be paired; a frame is whatever stands for it.

    Messages after a step of one stream alone wait until the lag shows whether they are late or wrong (`SensorLag`): at
    most until the next image, if nothing but messages was lost.
    """

    def __init__(self, *, follow: bool) -> None:
        """Begin with the first stamp of each; `follow` as for `TimeLine`."""
        streams = {IMU: IMU_TIME_JUMP_S, IMAGES: IMAGE_TIME_JUMP_S}
        super().__init__(streams, apart_s=IMU_TIME_JUMP_S, reference=IMU, follow=follow)
        self._forget()

    def _forget(self) -> None:
        self._lag = SensorLag()
        self._suspended: deque[tuple[str, int, Any]] = deque()  # stream, stamp and item
        self._set: dict[str, str] = {}  # streams whose clock was set alone, and what is wrong

    def restart(self) -> None:
        """Forget all stamps: the next ones are on the time line."""
        super().restart()
        self._forget()

    @property
    def faults(self) -> dict[str, str]:
        """Streams whose clock has left the time line, by name, with direction and size."""
        return super().faults | self._set

    def add(self, name: str, stamp_ns: int, item: Any) -> Admitted[Any]:
        """Add the next item of a stream; return what can be processed now."""
        self._lag.add(name, stamp_ns, self._streams[name].newest_ns)
        if name in self._lag.steps_ns:
            self._suspend(name, stamp_ns, item)
            if self._lag.steps_ns:
                return Admitted([])
        elif self._lag.steps_ns:
            return super().add(name, stamp_ns, item)
        else:
            self._suspended.append((name, stamp_ns, item))
        return self._release(name, stamp_ns)

    def _suspend(self, name: str, stamp_ns: int, item: Any) -> None:
        """Let an item wait; refuse all that do if the clock was set, and trust them if no image shows that for long."""
        self._suspended.append((name, stamp_ns, item))
        stamps = [at_ns for stream, at_ns, _ in self._suspended if stream == name]
        if abs(self._lag.steps_ns[name]) <= LEAST_NS:
            self._set.pop(name, None)  # it has been set right: the next image will show
        if name not in self._set:
            for_s = (stamps[-1] - stamps[0]) / NS_PER_S
            if len(stamps) < RUN_LENGTH or for_s < RUN_S:
                return
            if self._lag.followed < SURE:
                if not self._lag.followed or for_s >= FAULT_S:
                    self._lag.trust()
                return
            other = IMAGES if name == IMU else IMU
            step_s = self._lag.steps_ns[name] / NS_PER_S
            self._set[name] = (
                f"{name} stamps jump by {step_s:+.2f} s to {stamps[0]} ns, but not those of {other}: do their clocks "
                "agree?"
            )
        self._refuse("stamp_jump", self._set[name], len(stamps))
        self._suspended = deque(entry for entry in self._suspended if entry[0] != name)

    def _release(self, name: str, stamp_ns: int) -> Admitted[Any]:
        """Add what waited, but for stray stamps: those ahead of a later message of their stream."""
        self._set.clear()
        items, jump = [], None
        waiting, self._suspended = self._suspended, deque()
        for stream, at_ns, item in waiting:
            if stream == name and at_ns > stamp_ns:
                self._refuse("stamp_jump", f"{stream} stamp {at_ns} ns is ahead of later ones")
                continue
            admitted = super().add(stream, at_ns, item)
            items += admitted.items
            jump = admitted.jump or jump
        return Admitted(items, jump)


def sensor_time_line(policy: str) -> SensorTimeLine:
    """Return the time line of readings and frames under a policy."""
    return SensorTimeLine(follow=policy != "refuse")


def bridges(jump: TimeJump, policy: str) -> bool:
    """Return whether the motion goes on over a jump, as unknown; otherwise the stage starts again."""
    return policy == "bridge" and 0.0 < jump.size_s <= MOST_BRIDGED_S


def carried_over(estimate: NavEstimate, stamp_ns: int, imu: ImuConfig) -> NavEstimate:
    """Return an estimate as the start state after a jump of the clock.

    Nobody knows how much time has passed, from none to all of the jump: the mean stays, the covariance grows as by
    unknown motion over the jump.

    Args:
        estimate: the last one before the jump.
        stamp_ns: of the first frame after it, by the new clock [ns].
        imu: gravity.
    """
    state = estimate.state
    elapsed_ns = min(abs(stamp_ns - state.stamp_ns), round(MOST_ELAPSED_S * NS_PER_S)) or 1
    F, Q = transition(state, unknown_motion_since(state, state.stamp_ns + elapsed_ns, imu), imu)
    return NavEstimate(dataclasses.replace(state, stamp_ns=stamp_ns), F @ estimate.covariance @ F.T + Q)
