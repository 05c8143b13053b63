# SPDX-License-Identifier: Apache-2.0
"""When a recorded message may be replayed: by the graph's own progress (lock-step) or by the wall clock. No ROS here.

A pacer's `order` turns recorded messages into those that may be published now; None means: ask again later.
Lock-step allows each vehicle one unanswered frame, so that the vehicles compute side by side, and
no vehicle runs ahead of another's unanswered frame by `OVERLAP_NS` or more, so that what one hears of the other at an
epoch doesn't depend on the machine's speed. Inertial readings go on while a frame that is waited for still needs them.
Start states come from `starts_ns`, which may grow: while a vehicle's is unknown, its front end's answer has to do.
"""

import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from enum import Enum
from typing import Protocol

from uav_vslam.types import NS_PER_S

OVERLAP_NS = NS_PER_S // 10
EARLY_ANSWER = "stereo_features"
PAIR_NS = 2_000_000  # left and right of one frame differ by no more than this
IMU_AHEAD = 250  # unanswered readings: half of the subscriber's queue
IMU_GAP_NS = 3 * NS_PER_S  # images are held in memory while a reading is looked for no farther than this


class Kind(Enum):
    """What a recorded message is to the pacing."""

    LEFT = "left image"
    RIGHT = "right image"
    INFO = "camera info"
    IMU = "inertial reading"
    OTHER = "other"


FRAME_PARTS = frozenset({Kind.LEFT, Kind.RIGHT, Kind.INFO})


@dataclass(frozen=True, slots=True, eq=False)
class Recorded:
    """A message of a recording.

    Attributes:
        topic, message_type: as recorded ("/uav1/imu/data_raw", "sensor_msgs/msg/Imu").
        vehicle: its namespace without slashes; "" for what belongs to the whole fleet.
        kind: what it is to the pacing.
        stamp_ns: time in its header [ns].
        payload: serialised message (CDR).
    """

    topic: str
    message_type: str
    vehicle: str
    kind: Kind
    stamp_ns: int
    payload: bytes = b""


class Answers:
    """Which frames the graph still owes an answer, for every topic on which each vehicle answers.

    Attributes:
        frames: complete frames published, by vehicle.
    """

    def __init__(self, vehicles: Iterable[str], starts_ns: dict[str, int], topics: Iterable[str]) -> None:
        """Await answers on `topics` to each frame not before its vehicle's start; earlier ones the backend drops."""
        names, self._topics = tuple(vehicles), tuple(topics)
        self._starts_ns = starts_ns
        self._parts: dict[str, dict[Kind, int]] = {name: {} for name in names}  # stamps of the newest frame
        self._newest_ns = dict.fromkeys(names, -1)
        self._open: dict[str, dict[int, set[str]]] = {name: {} for name in names}
        self.frames = dict.fromkeys(names, 0)

    def published(self, message: Recorded) -> None:
        """Note a part of a frame; the last part makes the frame one to be answered."""
        if self.begins_frame(message):
            self._parts[message.vehicle] = {}
        parts = self._parts[message.vehicle]
        if message.kind not in parts:
            parts[message.kind] = message.stamp_ns
            if parts.keys() == FRAME_PARTS:
                self._complete(message.vehicle, parts[Kind.LEFT])

    def begins_frame(self, message: Recorded) -> bool:
        """Say whether this is the first part of a frame."""
        stamps = self._parts[message.vehicle].values()
        return not stamps or any(abs(message.stamp_ns - stamp_ns) > PAIR_NS for stamp_ns in stamps)

    def answered(self, vehicle: str, topic: str, stamp_ns: int) -> None:
        """Note an answer; one that nobody waits for changes nothing."""
        waiting = self._open[vehicle]
        if stamp_ns in waiting:
            waiting[stamp_ns].discard(topic)
            if not waiting[stamp_ns]:
                del waiting[stamp_ns]

    def open(self, vehicle: str | None = None) -> list[tuple[str, int]]:
        """Return (vehicle, stamp) of every frame with an answer missing."""
        vehicles = self._open if vehicle is None else (vehicle,)
        return [(name, stamp_ns) for name in vehicles for stamp_ns in self._open[name]]

    def forget(self, vehicle: str, stamp_ns: int) -> None:
        """Wait no longer for the answers to a frame."""
        del self._open[vehicle][stamp_ns]

    def missing(self) -> list[tuple[str, int]]:
        """Return (topic, stamp) of every answer that is missing."""
        return [
            (f"/{vehicle}/{topic}", stamp_ns)
            for vehicle, stamp_ns in self.open()
            for topic in sorted(self._open[vehicle][stamp_ns], reverse=True)
        ]

    def _complete(self, vehicle: str, stamp_ns: int) -> None:
        self.frames[vehicle] += 1
        start_ns = self._starts_ns.get(vehicle)
        topics = {EARLY_ANSWER} if start_ns is None else set(self._topics)
        if not self._topics or stamp_ns <= self._newest_ns[vehicle] or stamp_ns < (start_ns or 0):
            return
        self._newest_ns[vehicle] = stamp_ns
        self._open[vehicle][stamp_ns] = topics


class Readings:
    """How far each vehicle's inertial readings have been published, and how many its INS has yet to take in."""

    def __init__(self, vehicles: Iterable[str], starts_ns: dict[str, int], ahead: int | None = IMU_AHEAD) -> None:
        """Let `ahead` readings be unanswered; None where nobody answers them."""
        names, self._starts_ns, self._ahead = tuple(vehicles), starts_ns, ahead
        self._unanswered: dict[str, deque[int]] = {name: deque() for name in names}
        self._newest_ns = dict.fromkeys(names, -1)

    def published(self, message: Recorded) -> None:
        """Note a reading; those before the start are never answered."""
        vehicle, stamp_ns = message.vehicle, message.stamp_ns
        self._newest_ns[vehicle] = max(stamp_ns, self._newest_ns[vehicle])
        if self._ahead is not None and vehicle in self._starts_ns and stamp_ns > self._starts_ns[vehicle]:
            self._unanswered[vehicle].append(stamp_ns)

    def answered(self, vehicle: str, stamp_ns: int) -> None:
        """Note that the INS has taken in the readings up to a stamp."""
        waiting = self._unanswered[vehicle]
        while waiting and waiting[0] <= stamp_ns:
            waiting.popleft()

    def has_room(self, vehicle: str) -> bool:
        """Say whether another reading surely fits the INS's queue."""
        return self._ahead is None or len(self._unanswered[vehicle]) < self._ahead

    def cover(self, vehicle: str, stamp_ns: int) -> bool:
        """Say whether a reading at or after the stamp is out."""
        return self._newest_ns[vehicle] >= stamp_ns

    def backlog(self) -> list[tuple[str, int]]:
        """Return (vehicle, oldest unanswered stamp) of each vehicle whose INS has fallen behind."""
        return [(name, waiting[0]) for name, waiting in self._unanswered.items() if not self.has_room(name)]


class Pacer(Protocol):
    """Decides when a recorded message may go."""

    def order(self, recorded: Iterable[Recorded]) -> Iterator[Recorded | None]:
        """Yield what may be published now, or None to be asked again later."""


class LockStep:
    """Paces by the answers of the graph, so that nothing is lost however slow the machine is."""

    def __init__(self, answers: Answers, readings: Readings) -> None:
        """Pace by `answers` to frames and by the room in the INS's queue of `readings`."""
        self._answers, self._readings = answers, readings
        self._held: deque[Recorded] = deque()

    def order(self, recorded: Iterable[Recorded]) -> Iterator[Recorded | None]:
        """Yield what may be published now, or None to wait for an answer; end when all that can come has come."""
        source = iter(recorded)
        while True:
            message = self._choose(source)
            if message is None and not self._held and not self._answers.open():
                return
            if message is not None:
                self._note(message)
            yield message

    def _choose(self, source: Iterator[Recorded]) -> Recorded | None:
        if not self._held:
            self._held.extend(_take_one(source))
        if self._held and self._may_go(self._held[0]):
            return self._held.popleft()
        if starved := self._starved():
            return self._reading_for(starved, source)
        return None

    def _may_go(self, message: Recorded) -> bool:
        if message.kind is Kind.IMU:
            return self._readings.has_room(message.vehicle)
        if message.kind not in FRAME_PARTS or not self._answers.begins_frame(message):
            return True
        return not any(
            vehicle == message.vehicle or stamp_ns <= message.stamp_ns - OVERLAP_NS
            for vehicle, stamp_ns in self._answers.open()
        )

    def _starved(self) -> list[tuple[str, int]]:
        """Frames that can't be answered yet, because the reading that closes their interval is still to come."""
        return [frame for frame in self._answers.open() if not self._readings.cover(*frame)]

    def _reading_for(self, starved: list[tuple[str, int]], source: Iterator[Recorded]) -> Recorded | None:
        """Take the next reading that a frame needs out of turn; everything else keeps its place."""
        vehicles = {vehicle for vehicle, _ in starved}
        for place, message in enumerate(self._held):
            if message.kind is Kind.IMU and message.vehicle in vehicles:
                if not self._may_go(message):
                    return None
                del self._held[place]
                return message
        limit_ns = min(stamp_ns for _, stamp_ns in starved) + IMU_GAP_NS
        while not self._held or self._held[-1].stamp_ns <= limit_ns:
            if not (taken := _take_one(source)):
                break
            self._held.extend(taken)
            if taken[0].kind is Kind.IMU and taken[0].vehicle in vehicles:
                return self._held.pop() if self._may_go(taken[0]) else None
        for frame in starved:  # there is no such reading, or none that could be waited for
            self._answers.forget(*frame)
        return None

    def _note(self, message: Recorded) -> None:
        if message.kind in FRAME_PARTS:
            self._answers.published(message)
        elif message.kind is Kind.IMU:
            self._readings.published(message)


class RealTime:
    """Paces by the wall clock, whether the graph keeps up or not."""

    def __init__(self, answers: Answers, rate: float, clock: Callable[[], float] = time.monotonic) -> None:
        """Replay at `rate` times the recorded speed; `answers` only takes note."""
        self._answers, self._rate, self._clock = answers, rate, clock

    def order(self, recorded: Iterable[Recorded]) -> Iterator[Recorded | None]:
        """Yield each message when its time has come, and None until then."""
        begin_s, first_ns = self._clock(), None
        for message in recorded:
            first_ns = message.stamp_ns if first_ns is None else first_ns
            due_s = begin_s + (message.stamp_ns - first_ns) / NS_PER_S / self._rate
            while self._clock() < due_s:
                yield None
            if message.kind in FRAME_PARTS:
                self._answers.published(message)
            yield message


def _take_one(source: Iterator[Recorded]) -> list[Recorded]:
    message = next(source, None)
    return [] if message is None else [message]
