# SPDX-License-Identifier: Apache-2.0
"""Reads all of one vehicle's recording in one pass, faults included, for `inspection`: nothing here refuses it."""

import zlib
from array import array
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uav_vslam.config import InputConfig
from uav_vslam.config.input import image_names
from uav_vslam.datasets.bag import IMAGE_TYPES
from uav_vslam.datasets.camera_calibration import Calibration
from uav_vslam.datasets.cdr import RawMessage, decode
from uav_vslam.datasets.frame_tree import TF, TF_STATIC, UnmovedFrames
from uav_vslam.datasets.messages import (
    TRUTH_TYPES,
    header_stamp_ns,
    image_of,
    imu_of,
    navigation_state_of,
    transforms_of,
    truth_of,
)
from uav_vslam.datasets.rosbag import TopicInfo, Topics, iter_raw, topics_of
from uav_vslam.datasets.sensor_setup import SensorSetup
from uav_vslam.datasets.stereo_sync import StereoPair, StereoPairer
from uav_vslam.datasets.truth_track import TruthSeries, TruthTrack
from uav_vslam.errors import BagError, CalibrationError
from uav_vslam.geometry.stereo import SIDES
from uav_vslam.ins.imu_series import ImuSeries
from uav_vslam.ins.split_imu import SplitImu
from uav_vslam.types import NS_PER_S, ImuSample, NavEstimate, StereoFrame

Array = NDArray[np.float64]

TYPES = {  # that can be read, by role
    "left": IMAGE_TYPES,
    "right": IMAGE_TYPES,
    "left_info": ("sensor_msgs/msg/CameraInfo",),
    "right_info": ("sensor_msgs/msg/CameraInfo",),
    "imu": ("sensor_msgs/msg/Imu",),
    "accel": ("sensor_msgs/msg/Imu",),
    "initial_state": ("uav_vslam_msgs/msg/NavigationState",),
    "truth": TRUTH_TYPES,
}
SAMPLES = 8  # images of each camera, and pairs, that are decoded
COUPLE_NS = NS_PER_S // 2  # largest time between two pairs that still show the same
HEADER_BYTES = 12  # CDR header and stamp: all else of two equal images is equal


def median_period_ns(stamps_ns: NDArray[np.int64]) -> float:
    """Return the median distance of increasing stamps (N,) [ns]; NaN if there are too few."""
    steps = np.diff(stamps_ns)
    return float(np.median(steps[steps > 0])) if (steps > 0).any() else float("nan")


@dataclass(slots=True)
class Stream:
    """One topic's messages in recorded order.

    Attributes:
        topic, msgtype: name and type.
        stamps_ns: (N,) of the headers [ns].
        recorded_ns: (N,) when they were recorded [ns].
        errors: reasons why messages could not be read.
    """

    topic: str
    msgtype: str
    stamps_ns: NDArray[np.int64]
    recorded_ns: NDArray[np.int64]
    errors: list[str] = field(default_factory=list)

    def __len__(self) -> int:
        return len(self.stamps_ns)

    @property
    def period_ns(self) -> float:
        """Median distance of its increasing stamps [ns]; NaN if there are too few."""
        return median_period_ns(self.stamps_ns)


@dataclass(slots=True)
class Survey:
    """One vehicle's recording.

    Attributes:
        vehicle: name.
        input: where its data come from.
        topics: all of the recording.
        streams: by role, a field of `TopicsConfig`; those that were recorded with a type that can be read.
        imu: readings in the IMU's own axes.
        forces: readings of an accelerometer on a topic of its own.
        unmatched: how many readings of the gyroscope had none of these.
        setup: calibration.
        problems: why the calibration files or /tf_static can't be read.
        initial: start states.
        child_frames: by role, the body's frame in the first start state and truth, and that of the accelerometer.
        truth: true motion, or None.
        repeated: by side, (N,) whether an image equals the one before.
        images: by side, some decoded images.
        image_frames: by side, the frame of the first of them; may be empty.
        pair_count: pairs that the graph makes of the images.
        samples: some pairs that are not frozen, each with the next one if that is soon after.
        damage: what broke off reading; empty if nothing did.
    """

    vehicle: str
    input: InputConfig
    topics: Topics
    setup: SensorSetup
    streams: dict[str, Stream] = field(default_factory=dict)
    imu: ImuSeries = field(default_factory=ImuSeries)
    forces: ImuSeries = field(default_factory=ImuSeries)
    unmatched: int = 0
    problems: list[str] = field(default_factory=list)
    initial: list[NavEstimate] = field(default_factory=list)
    child_frames: dict[str, str] = field(default_factory=dict)
    truth: TruthTrack | None = None
    repeated: dict[str, NDArray[np.bool_]] = field(default_factory=dict)
    images: dict[str, list[NDArray[Any]]] = field(default_factory=lambda: {side: [] for side in SIDES})
    image_frames: dict[str, str] = field(default_factory=dict)
    pair_count: int = 0
    samples: list[tuple[StereoFrame, StereoFrame | None]] = field(default_factory=list)
    damage: str = ""

    @property
    def unnamed_cameras(self) -> dict[str, str]:
        """Frames of the images of cameras, by side, whose lens is in a file, but neither their place nor a frame."""
        known = SIDES[: len(self.setup.files.cameras)]
        frames = {side: self.image_frames.get(side, "") for side in self.setup.missing_infos if side in known}
        return {side: frame for side, frame in frames.items() if frame}


def topic_of(topics: Mapping[str, TopicInfo], vehicle: str, config: InputConfig, role: str) -> str | None:
    """Return the recorded topic of a role that can be read, or None."""
    name = config.topic(vehicle, role)
    names = image_names(name) if role in SIDES else (name,)
    return next((one for one in names if one in topics and topics[one].msgtype in TYPES[role]), None)


def roles_of(topics: Mapping[str, TopicInfo], vehicle: str, config: InputConfig) -> dict[str, str]:
    """Return the role of each recorded topic of a vehicle that can be read."""
    found = {topic_of(topics, vehicle, config, role): role for role in TYPES}
    return {topic: role for topic, role in found.items() if topic is not None}


def message_count(topics: Mapping[str, TopicInfo], vehicle: str, config: InputConfig) -> int:
    """Return how many messages `survey_flight` reads."""
    wanted = {*roles_of(topics, vehicle.strip("/"), config), TF_STATIC, TF}
    return sum(info.count for topic, info in topics.items() if topic in wanted)


def survey_flight(
    paths: Sequence[Path], vehicle: str, config: InputConfig, *, on_message: Callable[[], None]
) -> Survey:
    """Read all that is recorded of one vehicle.

    Args:
        paths: bags that together hold its topics.
        vehicle: its ROS namespace.
        config: its topics, frames and calibration files.
        on_message: called after each message, for a progress bar.

    Raises:
        BagError: a path is missing or not a bag, or nothing of it can be read.
    """
    reader = _Reader(topics_of(paths), vehicle.strip("/"), config)
    try:
        for raw in iter_raw(paths, reader.wanted):
            reader.add(raw)
            on_message()
    except BagError as error:
        reader.found.damage = str(error)
    return reader.result()


class _Reader:
    """Collects the messages of one vehicle."""

    def __init__(self, topics: Topics, vehicle: str, config: InputConfig) -> None:
        setup, problems = _setup(vehicle, config)
        self.found = Survey(vehicle, config, topics, setup, problems=problems)
        self._roles = roles_of(topics, vehicle, config)
        self._stamps = {role: array("q") for role in self._roles.values()}  # of header and recorder, in turn
        self._errors: dict[str, list[str]] = {role: [] for role in self._roles.values()}
        self._unmoved = UnmovedFrames()
        self._truth = TruthSeries()
        self._split: SplitImu[ImuSample] = SplitImu()
        self._checksums: dict[str, list[int]] = {side: [] for side in SIDES}
        self._pairer: StereoPairer[RawMessage | None] = StereoPairer(
            tolerance_ns=round(config.pair_tolerance_s * NS_PER_S)
        )
        self._last: StereoPair[RawMessage | None] | None = None

    @property
    def wanted(self) -> list[str]:
        """Topics to read."""
        return [*self._roles, TF_STATIC, TF]

    def add(self, raw: RawMessage) -> None:
        """Add a message; one that can't be read is counted."""
        if raw.topic == TF_STATIC:
            try:
                self.found.setup.frames.add(*transforms_of(decode(raw)))
            except (BagError, CalibrationError) as error:
                self.found.problems.append(str(error))
            return
        if raw.topic == TF:
            with suppress(BagError, CalibrationError):  # of another frame
                self._unmoved.add(transforms_of(decode(raw))[0])
            return
        role = self._roles[raw.topic]
        try:
            self._stamps[role].extend((header_stamp_ns(raw.data), raw.stamp_ns))
            self._add_image(role, raw) if role in SIDES else self._add_message(role, decode(raw))
        except (BagError, CalibrationError, ValueError) as error:
            self._errors[role].append(str(error))

    def result(self) -> Survey:
        """Return what was found."""
        if self.found.setup.missing_transforms():
            self.found.setup.frames.borrow(self._unmoved.edges)
        for topic, role in self._roles.items():
            stamps = np.array(self._stamps[role], np.int64).reshape(-1, 2)
            info = self.found.topics[topic]
            self.found.streams[role] = Stream(topic, info.msgtype, stamps[:, 0], stamps[:, 1], self._errors[role])
        for side, checksums in self._checksums.items():
            self.found.repeated[side] = np.diff(np.array(checksums, np.int64), prepend=-1) == 0
        self.found.truth = self._truth.track() if self._truth else None
        self.found.unmatched = self._split.unmatched
        return self.found

    def _add_message(self, role: str, built: Any) -> None:
        if role == "imu":
            if self.found.setup.imu_frame is None:
                self.found.setup.imu_frame = built.header.frame_id
            self._add_reading(imu_of(built))
        elif role == "accel":
            self.found.child_frames.setdefault(role, built.header.frame_id)
            self._add_force(imu_of(built))
        elif role == "truth":
            self.found.child_frames.setdefault(role, getattr(built, "child_frame_id", ""))
            self._truth.add(truth_of(built))
        elif role == "initial_state":
            self.found.child_frames.setdefault(role, built.child_frame_id)
            self.found.initial.append(navigation_state_of(built))
        else:
            side = role.removesuffix("_info")
            if side not in self.found.setup.cameras:
                self.found.setup.add_camera(side, built)

    def _add_reading(self, reading: ImuSample) -> None:
        if self.found.input.topics.accel:
            self._add_complete(self._split.add_gyro(reading.stamp_ns, reading))
        else:
            self.found.imu.extend([reading])

    def _add_force(self, reading: ImuSample) -> None:
        self.found.forces.extend([ImuSample(reading.stamp_ns, np.zeros(3), reading.accel)])
        self._add_complete(self._split.add_accel(reading.stamp_ns, reading.accel))

    def _add_complete(self, complete: list[tuple[ImuSample, Array]]) -> None:
        self.found.imu.extend(ImuSample(one.stamp_ns, one.gyro, force) for one, force in complete)

    def _add_image(self, side: str, raw: RawMessage) -> None:
        number = len(self._checksums[side])
        self._checksums[side].append(zlib.crc32(memoryview(raw.data)[HEADER_BYTES:]))
        frozen = number > 0 and self._checksums[side][-1] == self._checksums[side][-2]
        pair = self._pairer.add(side, header_stamp_ns(raw.data), None if frozen else raw)
        if pair is not None:
            self._add_pair(raw.topic, pair)
        if number % max(1, self.found.topics[raw.topic].count // SAMPLES) == 0:  # last: it may be refused
            built = decode(raw)
            self.found.image_frames.setdefault(side, built.header.frame_id.lstrip("/"))
            self.found.images[side].append(image_of(built))

    def _add_pair(self, topic: str, pair: StereoPair[RawMessage | None]) -> None:
        """Count a pair, and keep some of those that are not frozen, preferably where the next one follows soon."""
        last, self._last = self._last, pair
        self.found.pair_count += 1
        step = max(2, self.found.topics[topic].count // SAMPLES)
        late = self.found.pair_count - len(self.found.samples) * step - 2
        if late < 0 or last is None:
            return
        first, second = (_frame(one, self.found.setup.time_offset_ns) for one in (last, pair))
        soon = second is not None and pair.stamp_ns - last.stamp_ns <= COUPLE_NS
        if first is not None and (soon or late >= step // 2):
            self.found.samples.append((first, second if soon else None))


def _setup(vehicle: str, config: InputConfig) -> tuple[SensorSetup, list[str]]:
    """Return the setup with the calibration files; or without them, and the reason."""
    try:
        return SensorSetup.of(vehicle, config), []
    except CalibrationError as error:
        return SensorSetup(vehicle, config, Calibration()), [str(error)]


def _frame(pair: StereoPair[RawMessage | None], time_offset_ns: int) -> StereoFrame | None:
    """Return the decoded pair with a stamp of the IMU's clock, None if an image is frozen or can't be decoded."""
    if pair.left is None or pair.right is None:
        return None
    try:
        left, right = image_of(decode(pair.left)), image_of(decode(pair.right))
    except (BagError, ValueError):
        return None
    return StereoFrame(pair.stamp_ns + time_offset_ns, left, right)
