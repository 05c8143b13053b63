# SPDX-License-Identifier: Apache-2.0
"""Pacing of a replay: lock-step with the graph, or real time by the wall clock. Imports no ROS.

A pacer's `order` yields the messages that may be published now; None means: ask again later.
Lock-step allows each vehicle one unanswered frame, so that the vehicles compute in parallel, and no vehicle runs ahead
of another's unanswered frame by `OVERLAP_NS` or more, so that the packets available at an epoch do not depend on the
machine's speed. IMU samples continue while an unanswered frame needs them.
Start states come from `starts_ns`, which may grow: while a vehicle's is unknown, its front end's answer suffices, and
its INS, which can't answer yet, has `EARLY_PERIOD_S` of real time for each frame.
Messages whose stamps leave the time line are not waited for: the graph holds them until the jump is confirmed.
"""

import itertools
import time
from collections import defaultdict, deque
from collections.abc import Callable, Iterable, Iterator
from typing import Protocol

from uav_vslam.ins.sensor_clock import sensor_time_line
from uav_vslam.ins.sensor_lag import IMAGES, IMU
from uav_vslam.ros.answers import Answers, Readings
from uav_vslam.ros.recorded import FRAME_PARTS, Kind, Recorded
from uav_vslam.stamps import TimeLine
from uav_vslam.types import NS_PER_S

STEP_S, LONGEST_STEP_S = 0.005, 0.05  # period of looks at what is due
OVERLAP_NS = NS_PER_S // 10
EARLY_PERIOD_S = 0.15  # about as recorded
STEP_AHEAD_NS, STEP_BACK_NS = 10 * NS_PER_S, 2 * NS_PER_S  # real time: farther from one message to the next is a jump
IMU_GAP_NS = 3 * NS_PER_S  # limit of the look-ahead for an IMU sample, during which images are buffered


class Pacer(Protocol):
    """Decides when a recorded message may be published."""

    def order(self, recorded: Iterable[Recorded]) -> Iterator[Recorded | None]:
        """Yield what may be published now, or None to be called again later."""


class LockStep:
    """Back-pressure by the graph's answers, so that nothing is lost on a slow machine."""

    def __init__(self, answers: Answers, readings: Readings, clock: Callable[[], float] = time.monotonic) -> None:
        """Pace by `answers` to frames and by the capacity of the INS's queue of `readings`."""
        self._answers, self._readings, self._clock = answers, readings, clock
        self._next_early_s: dict[str, float] = {}  # when a vehicle without a start state may have its next frame
        self._held: deque[Recorded] = deque()
        self._lines: dict[str, TimeLine[int]] = defaultdict(lambda: sensor_time_line("bridge"))
        answers.is_admitted = lambda vehicle, stamp_ns: self._admits(vehicle, IMAGES, stamp_ns)

    def _admits(self, vehicle: str, name: str, stamp_ns: int) -> bool:
        """Return whether a stamp is on its vehicle's time line; when that jumps, begin again."""
        admitted = self._lines[vehicle].add(name, stamp_ns, stamp_ns)
        if admitted.jump is not None:
            self._answers.forget(vehicle)
            readings = [newest_ns for stream, newest_ns in admitted.items if stream == IMU]
            self._readings.forget(vehicle, readings[-1] if readings else -1)
        return len(admitted.items) == 1

    def order(self, recorded: Iterable[Recorded]) -> Iterator[Recorded | None]:
        """Yield what may be published now, or None to wait for an answer; end when nothing is left."""
        source = iter(recorded)
        while True:
            message = self._choose(source)
            if message is None and not self._held and not self._answers.open():
                return
            if message is not None:
                self._register(message)
            yield message

    def _choose(self, source: Iterator[Recorded]) -> Recorded | None:
        if not self._held:
            self._held.extend(itertools.islice(source, 1))
        if self._held and self._may_publish(self._held[0]):
            return self._held.popleft()
        if starved := self._starved():
            return self._next_reading(starved, source)
        return None

    def _may_publish(self, message: Recorded) -> bool:
        if message.kind is Kind.IMU:
            return self._readings.has_capacity(message.vehicle)
        if message.kind not in FRAME_PARTS or not self._answers.begins_frame(message):
            return True
        early_s = self._next_early_s.get(message.vehicle, 0.0)
        if self._answers.awaits_start(message.vehicle) and self._clock() < early_s:
            return False
        return not any(
            vehicle == message.vehicle or stamp_ns <= message.stamp_ns - OVERLAP_NS
            for vehicle, stamp_ns in self._answers.open()
        )

    def _starved(self) -> list[tuple[str, int]]:
        """Frames that can't be answered yet: the IMU sample that completes their interval is not published."""
        return [frame for frame in self._answers.open() if not self._readings.cover(*frame)]

    def _next_reading(self, starved: list[tuple[str, int]], source: Iterator[Recorded]) -> Recorded | None:
        """Publish the next IMU sample that a frame needs out of order; all else keeps its order."""
        vehicles = {vehicle for vehicle, _ in starved}
        for index, message in enumerate(self._held):
            if message.kind is Kind.IMU and message.vehicle in vehicles:
                if not self._may_publish(message):
                    return None
                del self._held[index]
                return message
        limit_ns = min(stamp_ns for _, stamp_ns in starved) + IMU_GAP_NS
        while not self._held or self._held[-1].stamp_ns <= limit_ns:
            if (taken := next(source, None)) is None:
                break
            self._held.append(taken)
            if taken.kind is Kind.IMU and taken.vehicle in vehicles:
                return self._held.pop() if self._may_publish(taken) else None
        for frame in starved:  # there is no such sample, or none within the look-ahead
            self._answers.discard(*frame)
        return None

    def _register(self, message: Recorded) -> None:
        if message.kind in FRAME_PARTS:
            if self._answers.begins_frame(message):
                self._next_early_s[message.vehicle] = self._clock() + EARLY_PERIOD_S
            self._answers.published(message)
        elif message.kind is not Kind.IMU:
            return
        elif self._admits(message.vehicle, IMU, message.stamp_ns):
            self._readings.published(message)
        else:  # the sample that completes an interval may be of another clock
            for vehicle, stamp_ns in self._starved():
                if vehicle == message.vehicle:
                    self._answers.discard(vehicle, stamp_ns)


class RealTime:
    """Paces by the wall clock, without back-pressure."""

    def __init__(self, answers: Answers, rate: float, clock: Callable[[], float] = time.monotonic) -> None:
        """Replay at `rate` times the recorded speed; `answers` are only counted."""
        self._answers, self._rate, self._clock = answers, rate, clock

    def order(self, recorded: Iterable[Recorded]) -> Iterator[Recorded | None]:
        """Yield each message when it is due, and None until then."""
        begins: dict[
            str, tuple[float, int]
        ] = {}  # by vehicle, as each has a clock of its own: a stamp, and when it was due
        newest_ns: dict[str, int] = {}
        for message in recorded:
            vehicle, stamp_ns = message.vehicle, message.stamp_ns
            if vehicle not in begins or not -STEP_BACK_NS <= stamp_ns - newest_ns[vehicle] <= STEP_AHEAD_NS:
                begins[vehicle] = self._clock(), stamp_ns  # the clock was set: neither a burst nor a pause
            newest_ns[vehicle] = stamp_ns
            begin_s, first_ns = begins[vehicle]
            due_s = begin_s + (stamp_ns - first_ns) / NS_PER_S / self._rate
            while self._clock() < due_s:
                yield None
            if message.kind in FRAME_PARTS:
                self._answers.published(message)
            yield message


def step_s(rate: float) -> float:
    """Return the period at which a replay asks for what is due [s]: 5 ms, and slower than real time, of the recording.

    Most of 200 looks a second find nothing at a tenth of real time, and cost a tenth of a core.
    """
    return min(STEP_S / rate, LONGEST_STEP_S) if 0.0 < rate < 1.0 else STEP_S
