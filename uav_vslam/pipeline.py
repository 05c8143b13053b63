# SPDX-License-Identifier: Apache-2.0
"""One vehicle without ROS: the nodes' stages, chained in one process."""

import dataclasses
import time
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

from uav_vslam.config import VehicleConfig
from uav_vslam.errors import BagError, InvalidMessage
from uav_vslam.geometry.stereo import StereoRig
from uav_vslam.ins.outliers import OUTLIER, OutlierFilter
from uav_vslam.ins.preintegrator import ImuPreintegrator
from uav_vslam.ins.sensor_clock import bridges, sensor_time_line
from uav_vslam.ins.sensor_lag import IMAGES, IMU
from uav_vslam.slam.frame_output import FrameOutput
from uav_vslam.slam.landmark_record import LandmarkRecord
from uav_vslam.slam.saved_map import Mapped, SavedMap
from uav_vslam.slam.stage import SlamStage
from uav_vslam.stamps import Admitted
from uav_vslam.types import ImuIncrement, ImuSample, NavEstimate, PoseEstimate, StereoFeatures, StereoFrame
from uav_vslam.vision.frontends import make_frontend


@dataclass(slots=True)
class VehicleTrack:
    """A whole flight of one vehicle, own-only.

    Attributes:
        vehicle: name.
        start: start state; None until there is one.
        frames_in: stereo pairs offered.
        outputs: one per frame processed, in stamp order; without joint information unless that is kept.
        landmarks: as last estimated at an epoch.
        dropped: frames that were not processed, by reason.
        alarms: subjects of faults of the cameras or the rig, by the frame's stamp [ns].
        features: found in each frame, by its stamp [ns] and without descriptors; empty unless they are kept.
        smoothed: the most likely poses given the whole flight, one per output; empty unless it was smoothed.
        stage_s: processor time of a stage on each frame [s], by the stage's name and the frame's stamp [ns].
        saved_map: all landmarks mapped; None unless they are kept.
        broken: why the recording ended early; empty if complete.
        warnings: problems for the user.
    """

    vehicle: str
    start: NavEstimate | None = None
    frames_in: int = 0
    outputs: list[FrameOutput] = field(default_factory=list)
    landmarks: LandmarkRecord = field(default_factory=LandmarkRecord)
    dropped: dict[str, int] = field(default_factory=dict)
    alarms: dict[int, tuple[str, ...]] = field(default_factory=dict)
    features: dict[int, StereoFeatures] = field(default_factory=dict)
    smoothed: list[PoseEstimate] = field(default_factory=list)
    stage_s: dict[str, dict[int, float]] = field(default_factory=lambda: {"frontend": {}, "backend": {}})
    saved_map: SavedMap | None = None
    broken: str = ""
    warnings: list[str] = field(default_factory=list)

    @property
    def poses(self) -> list[PoseEstimate]:
        """Own-only pose at each frame processed."""
        return [output.report.pose for output in self.outputs]


class VehiclePipeline:
    """Front end, INS and back end of one vehicle."""

    def __init__(
        self,
        initial: NavEstimate | None,
        *,
        rig: StereoRig,
        config: VehicleConfig,
        vehicle: str,
        keep_features: bool = False,
        keep_joints: bool = True,
        keep_map: bool = False,
    ) -> None:
        """Start at a state; with `start.method: in_flight` it may be None and is estimated.

        The track keeps its features, for pictures and smoothing, if asked to: some 10 kB a frame; and the joint
        information of each epoch, to be fused afterwards, unless asked not to: 3 MB with 200 landmarks. With
        `keep_map` all landmarks are collected for `mapped`.
        """
        self._keep_features, self._keep_joints = keep_features, keep_joints
        self._frontend = make_frontend(rig, config.frontend, config.rig)
        self._preintegrator = ImuPreintegrator(config.imu, initial.state if initial else None)
        self._outliers = OutlierFilter()
        self._policy = config.input.on_time_jump
        self._stamps = sensor_time_line(self._policy)
        self._slam = SlamStage(config, vehicle=vehicle, keep_map=keep_map)
        self._slam.rig = rig
        if initial is not None:
            self._slam.start(initial)
        self._refused: Counter[str] = Counter()
        self._told: set[str] = set()
        self._alarmed: set[str] = set()
        self._is_imu_fault_reported = False
        self.track = VehicleTrack(vehicle)

    @property
    def missing_start(self) -> str:
        """Reason for the missing start state; empty once there is one."""
        return self._slam.missing_start

    def mapped(self) -> Mapped:
        """Return all landmarks mapped until the last epoch."""
        return self._slam.mapped()

    def run(self, events: Iterable[ImuSample | StereoFrame | StereoFeatures]) -> Iterator[FrameOutput]:
        """Feed sensor data in stamp order and yield each frame's output as soon as it is complete.

        Raises:
            BagError: the clock of the recording jumps in a way that begins another flight.
        """
        for event in events:
            yield from self.add_imu(event) if isinstance(event, ImuSample) else self.add_frame(event)
        for reading in self._outliers.rest():
            self._preintegrator.add_imu(reading)
        yield from self._complete(self._preintegrator.increments(flush=True))

    def add_imu(self, sample: ImuSample) -> list[FrameOutput]:
        """Add an IMU sample; it may complete a waiting frame."""
        return self._add(self._stamps.add(IMU, sample.stamp_ns, sample))

    def _add_reading(self, sample: ImuSample) -> None:
        judged = self._outliers.add(sample)
        self._refused[OUTLIER] += judged.outlier is not None
        for reading in judged.readings:
            self._preintegrator.add_imu(reading)

    def _warn_of_stamps(self) -> None:
        """Warn of each stream's stamps once while faults last: their texts name the latest stamp."""
        faults = self._stamps.faults
        self.track.warnings += [text for name, text in faults.items() if name not in self._told]
        self._told = self._told | faults.keys() if faults else set()

    def add_frame(self, frame: StereoFrame | StereoFeatures) -> list[FrameOutput]:
        """Add a frame, or its simulated features; frames before the start state are dropped."""
        self.track.frames_in += 1
        features = self._extract_features(frame) if isinstance(frame, StereoFrame) else frame
        return self._add(self._stamps.add(IMAGES, frame.stamp_ns, features))

    def _add(self, admitted: Admitted[ImuSample | StereoFeatures]) -> list[FrameOutput]:
        """Add what the time line lets through; what is invalid is dropped and counted, as the nodes do."""
        if admitted.jump is not None:
            if not bridges(admitted.jump, self._policy):
                raise BagError(
                    f"{admitted.jump}: what follows is another flight, as scores and maps go by stamps; cut the "
                    "recording there, or replay it to the nodes"
                )
            self.track.warnings.append(f"{admitted.jump}: the motion in between is unknown")
        self._warn_of_stamps()
        for _, item in admitted.items:
            try:
                if isinstance(item, ImuSample):
                    self._add_reading(item)
                elif isinstance(item, StereoFeatures):
                    self._add_features(item)
            except InvalidMessage as error:
                self._refused[error.reason] += 1
        return self._complete(self._preintegrator.increments())

    def _add_features(self, features: StereoFeatures) -> None:
        self._slam.add_features(features)
        if self._keep_features:
            self.track.features[features.stamp_ns] = features.without_descriptors
        if self._preintegrator.start_ns is None or features.stamp_ns > self._preintegrator.start_ns:
            self._preintegrator.add_frame_stamp(features.stamp_ns)

    def _extract_features(self, frame: StereoFrame) -> StereoFeatures:
        """Run the front end; its alarms are kept, and each subject is reported the first time.

        A refused pair becomes a frame without points: the vehicle is dead-reckoned.
        """
        began_s = time.process_time()
        try:
            features = self._frontend.process(frame)
        except InvalidMessage as error:
            self._refused[error.reason] += 1
            features = StereoFeatures.empty(frame.stamp_ns)
        self.track.stage_s["frontend"][frame.stamp_ns] = time.process_time() - began_s
        for subject, text in self._frontend.alarms.items():
            if subject not in self._alarmed:
                self.track.warnings.append(f"frame {self.track.frames_in}: {text}")
        self._alarmed |= self._frontend.alarms.keys()
        if self._frontend.alarms:
            self.track.alarms[frame.stamp_ns] = tuple(self._frontend.alarms)
        return features

    def _complete(self, increments: list[ImuIncrement]) -> list[FrameOutput]:
        for increment in increments:
            self._slam.add_increment(increment)
        if increments:
            self._report_imu(self._preintegrator.statistics.fault)
        outputs = list(self._timed(self._slam.run()))
        self.track.start = self._slam.initial
        for output in outputs:
            self._record(output)
        self.track.warnings += [text for output in outputs for text in output.warnings]
        dropped = {**self._slam.dropped, **self._refused, **self._stamps.refused}
        self.track.dropped = {reason: count for reason, count in dropped.items() if count}
        return outputs

    def _record(self, output: FrameOutput) -> None:
        if output.joint is not None:
            self.track.landmarks.add(output.joint)
        self.track.outputs.append(output if self._keep_joints else dataclasses.replace(output, joint=None))

    def _report_imu(self, fault: str) -> None:
        """Warn of a fault of the readings, once: the rates in its text vary."""
        if fault and not self._is_imu_fault_reported:
            self.track.warnings.append(fault)
            self._is_imu_fault_reported = True

    def _timed(self, outputs: Iterable[FrameOutput]) -> Iterator[FrameOutput]:
        """Yield the back end's outputs and record the time that each took; results never depend on it."""
        began_s = time.process_time()
        for output in outputs:
            ended_s = time.process_time()
            self.track.stage_s["backend"][output.report.pose.stamp_ns] = ended_s - began_s
            yield output
            began_s = time.process_time()
