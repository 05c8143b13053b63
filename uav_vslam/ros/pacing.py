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

import time
from collections import defaultdict, deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from enum import Enum
from typing import Protocol

from uav_vslam.datasets.stereo_sync import PairTolerance
from uav_vslam.ins.sensor_clock import sensor_time_line
from uav_vslam.ins.sensor_lag import IMAGES, IMU
from uav_vslam.stamps import TimeLine
from uav_vslam.types import NS_PER_S

OVERLAP_NS = NS_PER_S // 10
EARLY_ANSWER = "stereo_features"
EARLY_PERIOD_S = 0.15  # about as recorded
IMU_AHEAD = 250  # unanswered IMU samples: half of the subscription's queue
STEP_AHEAD_NS, STEP_BACK_NS = 10 * NS_PER_S, 2 * NS_PER_S  # real time: farther from one message to the next is a jump
IMU_GAP_NS = 3 * NS_PER_S  # limit of the look-ahead for an IMU sample, during which images are buffered


class Kind(Enum):
    """Role of a recorded message in the pacing."""

    LEFT = "left image"
    RIGHT = "right image"
    INFO = "camera info"
    IMU = "IMU sample"
    OTHER = "other"


FRAME_PARTS = frozenset({Kind.LEFT, Kind.RIGHT, Kind.INFO})


@dataclass(frozen=True, slots=True)
class FrameShape:
    """What makes a frame of one vehicle.

    Attributes:
        parts: its messages.
        tolerance_ns: their stamps differ by no more than this [ns]; 0 for the default of `PairTolerance`.
        offset_ns: stamp of the answer minus that of the left image [ns].
    """

    parts: frozenset[Kind] = FRAME_PARTS
    tolerance_ns: int = 0
    offset_ns: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class Recorded:
    """A message of a recording.

    Attributes:
        topic, message_type: as recorded ("/uav1/imu/data_raw", "sensor_msgs/msg/Imu").
        vehicle: its namespace without slashes; "" for topics of the whole fleet.
        kind: its role in the pacing.
        stamp_ns: as `Recording.messages` has it [ns].
        payload: serialised message (CDR).
    """

    topic: str
    message_type: str
    vehicle: str
    kind: Kind
    stamp_ns: int
    payload: bytes = b""


class Answers:
    """Unanswered frames, for each topic on which a vehicle answers.

    Attributes:
        frames: complete frames published, by vehicle.
        processed: those of them that were answered on all topics.
    """

    def __init__(
        self,
        vehicles: Iterable[str],
        starts_ns: dict[str, int],
        topics: Iterable[str],
        shapes: Mapping[str, FrameShape] | None = None,
    ) -> None:
        """Await answers on `topics` to each frame from its vehicle's start on; the back end drops earlier ones.

        `is_admitted` says of a vehicle's frame whether its stamp is on the time line.
        """
        self.is_admitted: Callable[[str, int], bool] = lambda vehicle, stamp_ns: True
        names, self._topics = tuple(vehicles), tuple(topics)
        self._shapes = {name: FrameShape() for name in names} | dict(shapes or {})
        self._tolerances = {name: PairTolerance(shape.tolerance_ns) for name, shape in self._shapes.items()}
        self._starts_ns = starts_ns
        self._parts: dict[str, dict[Kind, int]] = {name: {} for name in names}  # stamps of the newest frame
        self._newest_ns = dict.fromkeys(names, -1)
        self._open: dict[str, dict[int, set[str]]] = {name: {} for name in names}
        self.frames = dict.fromkeys(names, 0)
        self.processed = dict.fromkeys(names, 0)

    def published(self, message: Recorded) -> None:
        """Register a part of a frame; with its last part the frame awaits answers.

        A frame off the time line is only counted; see `is_admitted`.
        """
        if message.kind is Kind.LEFT:
            self._tolerances[message.vehicle].add_left(message.stamp_ns)
        if self.begins_frame(message):
            self._parts[message.vehicle] = {}
        parts = self._parts[message.vehicle]
        if message.kind not in parts:
            parts[message.kind] = message.stamp_ns
            shape = self._shapes[message.vehicle]
            if parts.keys() >= shape.parts:
                self._complete(message.vehicle, parts[Kind.LEFT] + shape.offset_ns)

    def awaits_start(self, vehicle: str) -> bool:
        """Return whether a vehicle answers, but its start state is unknown yet."""
        return bool(self._topics) and vehicle not in self._starts_ns

    def begins_frame(self, message: Recorded) -> bool:
        """Return whether this is the first part of a frame."""
        stamps = self._parts[message.vehicle].values()
        tolerance_ns = self._tolerances[message.vehicle].ns
        return not stamps or any(abs(message.stamp_ns - stamp_ns) > tolerance_ns for stamp_ns in stamps)

    def answered(self, vehicle: str, topic: str, stamp_ns: int) -> None:
        """Register an answer; an unexpected one is ignored."""
        waiting = self._open[vehicle]
        if stamp_ns in waiting:
            waiting[stamp_ns].discard(topic)
            if not waiting[stamp_ns]:
                del waiting[stamp_ns]
                self.processed[vehicle] += topic in self._topics

    def open(self, vehicle: str | None = None) -> list[tuple[str, int]]:
        """Return (vehicle, stamp) of every unanswered frame."""
        vehicles = self._open if vehicle is None else (vehicle,)
        return [(name, stamp_ns) for name in vehicles for stamp_ns in self._open[name]]

    def discard(self, vehicle: str, stamp_ns: int) -> None:
        """Stop waiting for the answers to a frame."""
        del self._open[vehicle][stamp_ns]

    def forget(self, vehicle: str) -> None:
        """Stop waiting for a vehicle, whose clock has been set."""
        self._open[vehicle].clear()
        self._newest_ns[vehicle] = -1

    def missing(self) -> list[tuple[str, int]]:
        """Return (topic, stamp) of every missing answer."""
        return [
            (f"/{vehicle}/{topic}", stamp_ns)
            for vehicle, stamp_ns in self.open()
            for topic in sorted(self._open[vehicle][stamp_ns], reverse=True)
        ]

    def _complete(self, vehicle: str, stamp_ns: int) -> None:
        self.frames[vehicle] += 1
        start_ns = self._starts_ns.get(vehicle)
        topics = {EARLY_ANSWER} if start_ns is None else set(self._topics)
        if not self.is_admitted(vehicle, stamp_ns):
            return
        if not self._topics or stamp_ns <= self._newest_ns[vehicle] or stamp_ns < (start_ns or 0):
            return
        self._newest_ns[vehicle] = stamp_ns
        self._open[vehicle][stamp_ns] = topics


class Readings:
    """Each vehicle's newest published IMU sample, and those that its INS has not acknowledged."""

    def __init__(self, vehicles: Iterable[str], starts_ns: dict[str, int], ahead: int | None = IMU_AHEAD) -> None:
        """Allow `ahead` unanswered samples; None if nobody acknowledges them."""
        names, self._starts_ns, self._ahead = tuple(vehicles), starts_ns, ahead
        self._unanswered: dict[str, deque[int]] = {name: deque() for name in names}
        self._newest_ns = dict.fromkeys(names, -1)

    def published(self, message: Recorded) -> None:
        """Register a sample; those before the start are never answered."""
        vehicle, stamp_ns = message.vehicle, message.stamp_ns
        self._newest_ns[vehicle] = max(stamp_ns, self._newest_ns[vehicle])
        if self._ahead is not None and vehicle in self._starts_ns and stamp_ns > self._starts_ns[vehicle]:
            self._unanswered[vehicle].append(stamp_ns)

    def answered(self, vehicle: str, stamp_ns: int) -> None:
        """Register that the INS has processed the samples up to a stamp."""
        waiting = self._unanswered[vehicle]
        while waiting and waiting[0] <= stamp_ns:
            waiting.popleft()

    def forget(self, vehicle: str, newest_ns: int) -> None:
        """Go on at the newest sample of a clock that has been set."""
        self._unanswered[vehicle].clear()
        self._newest_ns[vehicle] = newest_ns

    def has_capacity(self, vehicle: str) -> bool:
        """Return whether the INS's queue can take another sample."""
        return self._ahead is None or len(self._unanswered[vehicle]) < self._ahead

    def cover(self, vehicle: str, stamp_ns: int) -> bool:
        """Return whether a sample at or after the stamp has been published."""
        return self._newest_ns[vehicle] >= stamp_ns

    def backlog(self) -> list[tuple[str, int]]:
        """Return (vehicle, oldest unanswered stamp) of each vehicle whose INS lags behind."""
        return [(name, waiting[0]) for name, waiting in self._unanswered.items() if not self.has_capacity(name)]


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
            self._held.extend(_take_one(source))
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
            if not (taken := _take_one(source)):
                break
            self._held.extend(taken)
            if taken[0].kind is Kind.IMU and taken[0].vehicle in vehicles:
                return self._held.pop() if self._may_publish(taken[0]) else None
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
        begin_s, first_ns, newest_ns = self._clock(), None, 0
        for message in recorded:
            if first_ns is None or not -STEP_BACK_NS <= message.stamp_ns - newest_ns <= STEP_AHEAD_NS:
                begin_s, first_ns = self._clock(), message.stamp_ns  # the clock was set: neither a burst nor a pause
            newest_ns = message.stamp_ns
            due_s = begin_s + (message.stamp_ns - first_ns) / NS_PER_S / self._rate
            while self._clock() < due_s:
                yield None
            if message.kind in FRAME_PARTS:
                self._answers.published(message)
            yield message


def _take_one(source: Iterator[Recorded]) -> list[Recorded]:
    message = next(source, None)
    return [] if message is None else [message]
