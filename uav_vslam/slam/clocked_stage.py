# SPDX-License-Identifier: Apache-2.0
"""The back end's inputs on one time line: what it does when stamps jump (`input.on_time_jump`).

Features and increments come from two processes, so a jump counts only if both make it; a wrong stamp of one is refused.
The INS decides about jumps ahead of up to `MOST_BRIDGED_S`: it goes on, with one increment over the jump, or it starts
again, and its next increment begins after the jump.
"""

from collections import Counter, deque
from collections.abc import Callable

from uav_vslam.config import VehicleConfig
from uav_vslam.ins.sensor_clock import EARLY_STARTS, MOST_BRIDGED_S, carried_over
from uav_vslam.ins.startup_buffer import MAX_UNCOVERED_S
from uav_vslam.slam.frame_queue import MAX_WAITING
from uav_vslam.slam.stage import SlamStage
from uav_vslam.stamps import IMU_TIME_JUMP_S, Admitted, TimeJump, TimeLine
from uav_vslam.types import NS_PER_S, ImuIncrement, NavEstimate, StereoFeatures

FEATURES, MOTION = "stereo_features", "ins/increment"
Item = StereoFeatures | ImuIncrement


class ClockedStage:
    """Feeds `SlamStage`, and replaces it by a new session where the clock begins another flight.

    Attributes:
        stage: the current one.
        line: the time line of the inputs.
        restarts: how often the stage was replaced.
    """

    def __init__(self, stage: SlamStage, config: VehicleConfig, next_session: Callable[[], int]) -> None:
        """Go on with a stage; sessions of later ones are asked for."""
        self.stage = stage
        self._config, self._next_session = config, next_session
        self._policy = config.input.on_time_jump
        streams = {FEATURES: MOST_BRIDGED_S, MOTION: MOST_BRIDGED_S}
        most = {FEATURES: MAX_WAITING}  # of those that wait for a jump to be confirmed, the stage takes no more
        self.line: TimeLine[Item] = TimeLine(streams, follow=self._policy != "refuse", most=most)
        self._starts: deque[NavEstimate] = deque(maxlen=EARLY_STARTS)
        self._dropped: Counter[str] = Counter()  # by the stages before this one
        self._reached_ns: int | None = None
        self.restarts = 0

    @property
    def dropped(self) -> dict[str, int]:
        """Counts of frames, motion and messages that were not used, by reason."""
        now = self.stage.dropped
        return {reason: now[reason] + self._dropped[reason] for reason in now} | dict(self.line.refused)

    def start(self, initial: NavEstimate) -> None:
        """Set the start state; one that comes in flight is for a flight that the clock may begin."""
        self._starts.append(initial)
        self.stage.start(initial)

    def reset(self) -> None:
        """Start again: a new session, without start state."""
        self._starts.clear()
        self.line.restart()
        self._replace(None)

    def add_features(self, features: StereoFeatures) -> str:
        """Add a frame's features; return what a jump of the clock did, empty without one."""
        return self._add(self.line.add(FEATURES, features.stamp_ns, features))

    def add_increment(self, increment: ImuIncrement) -> str:
        """Add the motion between two images; return what a jump of the clock did, empty without one."""
        return self._add(self.line.add(MOTION, increment.stamp_ns, increment))

    def _add(self, admitted: Admitted[Item]) -> str:
        outcome = self._follow(admitted.jump, admitted) if admitted.jump is not None else ""
        for _, item in admitted.items:
            if isinstance(item, StereoFeatures):
                self.stage.add_features(item)
                continue
            outcome = outcome or self._reset_at_break(item)
            self.stage.add_increment(item)
            self._reached_ns = item.stamp_ns
        return outcome

    def _follow(self, jump: TimeJump, admitted: Admitted[Item]) -> str:
        """Begin another session at the first frame after a jump, from the last estimate or a newer start state."""
        if not jump.is_back and (jump.size_s <= MOST_BRIDGED_S or self._is_motion_known(admitted)):
            return ""  # one stream was silent
        frames_ns = (item.stamp_ns for name, item in admitted.items if name == FEATURES)
        first_ns = min(frames_ns, default=jump.to_ns)  # none if features have not begun, or went on without motion
        before, initial = self.stage.nav, self._start_near(first_ns)
        if initial is None and before is not None and self._policy == "bridge":
            initial = carried_over(before, first_ns, self._config.imu)
        self._replace(initial)
        return f"{jump}; {self._outcome(initial)}"

    def _is_motion_known(self, admitted: Admitted[Item]) -> bool:
        """Return whether the increments go on where they were: cameras or front end were silent, no clock was set."""
        starts_ns = [item.start_ns for _, item in admitted.items if isinstance(item, ImuIncrement)]
        return self._reached_ns is not None and min(starts_ns, default=self._reached_ns) == self._reached_ns

    def _reset_at_break(self, increment: ImuIncrement) -> str:
        """Start again if the INS has: its increments no longer follow each other."""
        if self._policy != "reset" or self._reached_ns is None:
            return ""
        ahead_s = (increment.start_ns - self._reached_ns) / NS_PER_S
        if ahead_s <= IMU_TIME_JUMP_S:
            return ""
        self._replace(self._start_near(increment.start_ns))
        return f"the clock of the sensors jumped by {ahead_s:+.1f} s; {self._outcome(self.stage.initial)}"

    def _start_near(self, stamp_ns: int) -> NavEstimate | None:
        """Return the newest start state received that is of the time line which has begun at a stamp.

        That of the present flight is none, once a frame has used it.
        """
        near_ns, used = MAX_UNCOVERED_S * NS_PER_S, self.stage.initial if self.stage.nav is not None else None
        for start in reversed(self._starts):
            if start is not used and abs(start.state.stamp_ns - stamp_ns) <= near_ns:
                return start
        return None

    def _replace(self, initial: NavEstimate | None) -> None:
        self._dropped += Counter(self.stage.dropped)
        self.stage = self.stage.restarted(self._next_session(), initial)
        self._starts.clear()
        self._reached_ns = None
        self.restarts += 1

    def _outcome(self, initial: NavEstimate | None) -> str:
        origin = "waits for a start state" if initial is None else "goes on from a start state of the new clock"
        return f"session {self.stage.session} {origin}"
