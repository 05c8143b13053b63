# SPDX-License-Identifier: Apache-2.0
"""One vehicle without ROS: the same stages that the nodes run, chained in one process."""

from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

from uav_vslam.config import VehicleConfig
from uav_vslam.errors import InvalidMessage
from uav_vslam.geometry.stereo import StereoRig
from uav_vslam.ins.propagator import InsPropagator
from uav_vslam.slam.backend import FrameReport, SlamBackend, crosses_epoch
from uav_vslam.slam.frame_queue import FrameQueue
from uav_vslam.types import (
    ImuIncrement,
    ImuSample,
    JointInformation,
    NavEstimate,
    StereoFeatures,
    StereoFrame,
)
from uav_vslam.vision.stereo_points import StereoFrontend


@dataclass(frozen=True, slots=True)
class FrameOutput:
    """Everything that a frame produced.

    Attributes:
        report: own-only SLAM.
        dead_reckoning: the uncorrected INS at the same stamp.
        joint: the belief over pose and landmarks, at epochs only.
    """

    report: FrameReport
    dead_reckoning: NavEstimate
    joint: JointInformation | None


@dataclass(slots=True)
class VehicleTrack:
    """A whole flight of one vehicle, own-only.

    Attributes:
        vehicle: name.
        frames_in: stereo pairs offered.
        outputs: one per frame processed, in stamp order.
        dropped: frames that were not processed, by reason.
        broken: why the recording ended early; empty if it did not.
    """

    vehicle: str
    frames_in: int = 0
    outputs: list[FrameOutput] = field(default_factory=list)
    dropped: dict[str, int] = field(default_factory=dict)
    broken: str = ""


class VehiclePipeline:
    """Front end, INS and backend of one vehicle."""

    def __init__(
        self, initial: NavEstimate, *, rig: StereoRig, config: VehicleConfig, vehicle: str, session: int = 1
    ) -> None:
        self._epoch_s = config.fusion.epoch_s
        self._frontend = StereoFrontend(rig, config.frontend)
        self._ins = InsPropagator(initial, config.imu)
        self._backend = SlamBackend(initial, rig=rig, config=config, vehicle=vehicle, session=session)
        self._queue = FrameQueue(initial.state.stamp_ns)
        self._reckoned = {initial.state.stamp_ns: initial}  # dead reckoning of frames that are not complete
        self._previous_ns: int | None = None
        self._refused: Counter[str] = Counter()
        self.track = VehicleTrack(vehicle)

    def run(self, events: Iterable[ImuSample | StereoFrame | StereoFeatures]) -> Iterator[FrameOutput]:
        """Feed sensor data in stamp order and yield each frame's output as soon as it is complete."""
        for event in events:
            try:
                yield from self.add_imu(event) if isinstance(event, ImuSample) else self.add_frame(event)
            except InvalidMessage as error:  # dropped and counted, as the nodes do
                self._refused[error.reason] += 1
        yield from self._complete(self._ins.increments(flush=True))

    def add_imu(self, sample: ImuSample) -> list[FrameOutput]:
        """Take in a reading; it may complete a waiting frame."""
        self._ins.add_imu(sample)
        return self._complete(self._ins.increments())

    def add_frame(self, frame: StereoFrame | StereoFeatures) -> list[FrameOutput]:
        """Take in a frame, or its features where they are simulated; frames before the start state are dropped."""
        self.track.frames_in += 1
        self._queue.add_features(self._frontend.process(frame) if isinstance(frame, StereoFrame) else frame)
        if frame.stamp_ns > self._ins.start_ns:
            self._ins.add_frame_stamp(frame.stamp_ns)
        return self._complete(self._ins.increments())

    def _complete(self, increments: list[tuple[ImuIncrement, NavEstimate]]) -> list[FrameOutput]:
        for increment, reckoned in increments:
            self._queue.add_increment(increment)
            self._reckoned[increment.stamp_ns] = reckoned
        outputs = []
        while (frame := self._queue.pop()) is not None:
            outputs.append(self._process(*frame))
        dropped = {
            "before_start": self._queue.before_start,
            "without_motion": self._queue.without_motion,
            **self._refused,
        }
        self.track.dropped = {reason: count for reason, count in dropped.items() if count}
        return outputs

    def _process(self, features: StereoFeatures, increment: ImuIncrement | None) -> FrameOutput:
        report = self._backend.process(features, increment)
        at_epoch = crosses_epoch(self._previous_ns, features.stamp_ns, self._epoch_s)
        self._previous_ns = features.stamp_ns
        joint = self._backend.joint_information() if at_epoch else None
        output = FrameOutput(report, self._reckoned.pop(features.stamp_ns), joint)
        self.track.outputs.append(output)
        return output
