# SPDX-License-Identifier: Apache-2.0
"""What the graph has not answered yet of what a replay has published: frames and IMU samples. Imports no ROS."""

from collections import deque
from collections.abc import Callable, Iterable, Mapping

from uav_vslam.datasets.stereo_sync import PairTolerance
from uav_vslam.ros.recorded import FrameShape, Kind, Recorded

EARLY_ANSWER = "stereo_features"
IMU_AHEAD = 250  # unanswered IMU samples: half of the subscription's queue


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

    def open(self) -> list[tuple[str, int]]:
        """Return (vehicle, stamp) of every unanswered frame."""
        return [(vehicle, stamp_ns) for vehicle, stamps_ns in self._open.items() for stamp_ns in stamps_ns]

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
