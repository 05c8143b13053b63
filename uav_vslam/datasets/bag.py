# SPDX-License-Identifier: Apache-2.0
"""Reads one vehicle's flight from bags: calibration, start state, ground truth, sensor events in stamp order."""

import dataclasses
import heapq
import itertools
from collections.abc import Collection, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uav_vslam.config import InputConfig
from uav_vslam.config.input import image_names
from uav_vslam.datasets.cdr import RawMessage, decode
from uav_vslam.datasets.flight_writer import TF, TF_STATIC
from uav_vslam.datasets.frame_tree import Edge, UnmovedFrames
from uav_vslam.datasets.messages import (
    TRUTH_TYPES,
    header_stamp_ns,
    image_of,
    imu_of,
    navigation_state_of,
    stamp_ns_of,
    transforms_of,
    truth_of,
)
from uav_vslam.datasets.rosbag import TopicInfo, iter_raw, topics_of
from uav_vslam.datasets.sensor_setup import SensorSetup
from uav_vslam.datasets.stereo_sync import PairTolerance, StereoPairer
from uav_vslam.datasets.truth_track import TruthTrack, truth_track
from uav_vslam.errors import BagError, CalibrationError, InvalidMessage
from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.stereo import SIDES, StereoRig
from uav_vslam.ins.mounting import ImuMounting
from uav_vslam.numerics import nearest
from uav_vslam.types import NS_PER_S, ImuSample, NavEstimate, StereoFrame

DEFAULT_VEHICLE = "uav1"  # where topics do not begin with its name
IMAGE_TYPES = ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage")
TRIED_IMAGES = 100  # of which one must be readable
REORDER_NS = 500_000_000  # a message may be recorded this much later than its stamp


@dataclass(frozen=True, slots=True)
class BagFlight:
    """One vehicle's recording.

    Attributes:
        paths: the bags.
        vehicle: ROS namespace, without slashes at its ends.
        input: where its data come from.
        rig: calibration.
        initial_state: start state, or None if none was recorded.
        frame_count: left images recorded.
        left_topic, right_topic: of the images.
        T_body_imu: pose of the IMU.
        time_offset_ns: IMU time minus image stamp [ns].
        warnings: what is doubtful about the recording.
    """

    paths: tuple[Path, ...]
    vehicle: str
    input: InputConfig
    rig: StereoRig
    initial_state: NavEstimate | None
    frame_count: int
    left_topic: str
    right_topic: str
    T_body_imu: Pose
    time_offset_ns: int = 0
    warnings: tuple[str, ...] = ()

    @property
    def image_size(self) -> tuple[int, int]:
        """Width and height of both images [px]."""
        return self.rig.left.size

    def iter_events(self) -> Iterator[ImuSample | StereoFrame]:
        """Yield IMU samples, moved to the body, and image pairs in stamp order; at equal stamps the sample comes first.

        Raises:
            BagError: the recording is damaged (raised after all readable events), or a message can't be decoded. An
                undecodable image becomes an empty one: its frame has no points.
        """
        return _in_stamp_order(self._recorded_events())

    def truth(self) -> TruthTrack | None:
        """Return the true motion without poses that are not finite, maybe without any; None if none was recorded.

        Raises:
            BagError: a message can't be decoded.
        """
        samples, left_out = [], 0
        for raw in _readable(iter_raw(self.paths, [self.input.topic(self.vehicle, "truth")])):
            if raw.msgtype not in TRUTH_TYPES:
                return None
            try:
                samples.append(truth_of(decode(raw)))
            except InvalidMessage:
                left_out += 1
        return dataclasses.replace(truth_track(samples), left_out=left_out) if samples or left_out else None

    def stamps_apart_ns(self, first: int | None = None) -> NDArray[np.int64]:
        """Return the distance of each left image's stamp to the nearest right one's [ns].

        Args:
            first: only of so many images; None for all.
        """
        left, right = (self._stamps_ns(topic, first) for topic in (self.left_topic, self.right_topic))
        if len(right) == 0:
            return np.zeros(0, np.int64)
        return np.asarray(abs(right[nearest(left, right)] - left))

    def pair_tolerance_ns(self, first: int) -> int:
        """Return the largest difference between the stamps of a pair [ns], after the first so many left images."""
        tolerance = PairTolerance(round(self.input.pair_tolerance_s * NS_PER_S))
        for stamp_ns in self._stamps_ns(self.left_topic, first):
            tolerance.add_left(int(stamp_ns))
        return tolerance.ns

    def unpaired_reason(self) -> str:
        """Return why images found no partner, from the stamps of both cameras."""
        apart = self.stamps_apart_ns()
        if len(apart) == 0:
            return f"{self.left_topic} or {self.right_topic} holds no image"
        return (
            f"the nearest stamps of {self.left_topic} and {self.right_topic} are {np.median(apart) / 1e6:.3g} ms apart "
            "(median); see input.pair_tolerance_s"
        )

    def _stamps_ns(self, topic: str, first: int | None) -> NDArray[np.int64]:
        images = itertools.islice(self._images(topic), first)
        return np.array([header_stamp_ns(raw.data) for raw in images], np.int64)

    def left_images(self, stamps_ns: Collection[int]) -> Iterator[tuple[int, NDArray[Any]]]:
        """Yield stamp and pixels of the left images of some frames, as recorded; undecodable ones are left out.

        Args:
            stamps_ns: of the frames, as `iter_events` has them.
        """
        for raw in self._images(self.left_topic):
            stamp_ns = header_stamp_ns(raw.data) + self.time_offset_ns
            if stamp_ns in stamps_ns:
                pixels = _pixels_or_empty(decode(raw))
                if pixels.size:
                    yield stamp_ns, pixels

    def _images(self, topic: str) -> Iterator[RawMessage]:
        return _readable(iter_raw(self.paths, [topic]))

    def _recorded_events(self) -> Iterator[ImuSample | StereoFrame]:
        imu_topic = self.input.topic(self.vehicle, "imu")
        mounting = ImuMounting(self.T_body_imu)
        pairer: StereoPairer[Any] = StereoPairer(tolerance_ns=round(self.input.pair_tolerance_s * NS_PER_S))
        for raw in iter_raw(self.paths, [imu_topic, self.left_topic, self.right_topic]):
            built = decode(raw)
            if raw.topic == imu_topic:
                yield mounting.to_body(imu_of(built))
                continue
            add = pairer.add_left if raw.topic == self.left_topic else pairer.add_right
            pair = add(stamp_ns_of(built), built)
            if pair is not None:
                stamp_ns = pair.stamp_ns + self.time_offset_ns
                yield StereoFrame(stamp_ns, _pixels_or_empty(pair.left), _pixels_or_empty(pair.right))

    def check_images(self) -> None:
        """Decode the first readable image of each side, to fail early where `iter_events` would fail.

        Raises:
            BagError: there is none, or none of the first `TRIED_IMAGES` can be decoded.
            CalibrationError: it is not of the size that camera_info states.
        """
        for topic in (self.left_topic, self.right_topic):
            height, width = self._first_pixels(topic).shape[:2]
            if (width, height) != self.image_size:
                raise CalibrationError(
                    f"bag {_names(self.paths)}: images on {topic} are {width}x{height} px but the calibration says "
                    f"{self.image_size[0]}x{self.image_size[1]}; calibrate at the recorded size, or give K for it: "
                    "binning and region of interest of a camera_info are not applied"
                )

    def _first_pixels(self, topic: str) -> NDArray[Any]:
        """Return the first image that can be decoded: a camera's first exposure may fail, as any later one may."""
        refused = ""
        for raw in itertools.islice(self._images(topic), TRIED_IMAGES):
            try:
                return image_of(decode(raw))
            except BagError as error:
                refused = refused or str(error)
        if not refused:
            raise BagError(f"bag {_names(self.paths)} holds no message on {topic}; record the images")
        raise BagError(f"bag {_names(self.paths)}, {topic}: {refused}")


def _pixels_or_empty(built: Any) -> NDArray[Any]:
    try:
        return image_of(built)
    except BagError:
        return np.zeros((0, 0), np.uint8)


def vehicles(paths: Sequence[Path], config: InputConfig | None = None) -> list[str]:
    """Return the namespaces that have left images, sorted; the default one if the topic's name is absolute."""
    left = (config or InputConfig()).topics.left
    if left.startswith("/"):
        return [DEFAULT_VEHICLE]
    endings = [f"/{name}" for name in image_names(left)]
    topics = topics_of(paths)
    found = {topic.removesuffix(end).strip("/") for topic in topics for end in endings if topic.endswith(end)}
    return sorted(found - {""})  # topics in the root are no vehicle's, unless they are named from there


def open_flight(paths: Path | Sequence[Path], vehicle: str, config: InputConfig | None = None) -> BagFlight:
    """Read what is constant during a flight: calibration, start state and topic names.

    Args:
        paths: bags that together hold the vehicle's topics.
        vehicle: its ROS namespace.
        config: its topics, frames and calibration files; the conventional ones by default.

    Raises:
        BagError: a path is missing or not a bag, or a topic is missing.
        CalibrationError: a sensor's place in the body is unknown, or the calibrations contradict each other.
    """
    bags = (paths,) if isinstance(paths, Path) else tuple(paths)
    name, config = vehicle.strip("/"), config or InputConfig()
    topics, setup = topics_of(bags), SensorSetup.of(name, config)
    left_topic, right_topic = (_image_topic(bags, topics, config.topic(name, side)) for side in SIDES)
    infos = [config.topic(name, f"{side}_info") for side in SIDES] if setup.needs_infos else []
    for topic in (*infos, config.topic(name, "imu")):
        if topic not in topics:
            raise _missing_topic(bags, topics, topic)
    if (reading := _first(bags, config.topic(name, "imu"))) is not None:
        setup.imu_frame = reading.header.frame_id
    if setup.needs_frames and not {TF_STATIC, TF} & topics.keys():
        raise _missing_topic(bags, topics, TF_STATIC)
    try:
        _collect(bags, topics, setup)
        if TF in topics and setup.missing_transforms():
            setup.frames.borrow(unmoved_edges(bags))
        rig, T_body_imu = setup.rig(), setup.T_body_imu()
        start = _first(bags, config.topic(name, "initial_state"))
        if start is not None and (conflict := setup.conflict(start.child_frame_id)):
            raise CalibrationError(f"{config.topic(name, 'initial_state')} {conflict}")
        initial_state = None if start is None else navigation_state_of(start)
    except CalibrationError as error:
        raise CalibrationError(f"bag {_names(bags)}, vehicle {name}: {error}") from None
    except InvalidMessage as error:
        topic = config.topic(name, "initial_state")
        raise BagError(f"bag {_names(bags)}: {topic}: {error}; record a start state that is valid") from None
    return BagFlight(
        paths=bags,
        vehicle=name,
        input=config,
        rig=rig,
        initial_state=initial_state,
        frame_count=topics[left_topic].count,
        left_topic=left_topic,
        right_topic=right_topic,
        T_body_imu=T_body_imu,
        time_offset_ns=setup.time_offset_ns,
        warnings=tuple(_warnings(bags, setup)),
    )


def _warnings(bags: Sequence[Path], setup: SensorSetup) -> Iterator[str]:
    """Yield what is doubtful about the frames of a recording."""
    if setup.imu_unnamed:
        topic = setup.config.topic(setup.vehicle, "imu")
        yield f"{topic} has no frame_id, so the IMU counts as the body; set input.frames.imu if it is elsewhere"
    if setup.frames.moved:
        frames = ", ".join(sorted(setup.frames.moved))
        yield f"{TF_STATIC} places {frames} differently from message to message; the last one counts"
    topic = setup.config.topic(setup.vehicle, "truth")
    truth = _first(bags, topic)
    if truth is not None and truth.__msgtype__ not in TRUTH_TYPES:
        yield f"{topic} holds {truth.__msgtype__} and is not read: record one of {', '.join(TRUTH_TYPES)}"
    if conflict := setup.conflict(getattr(truth, "child_frame_id", "")):
        yield f"{topic} {conflict}"


def _image_topic(bags: Sequence[Path], topics: dict[str, TopicInfo], name: str) -> str:
    found = [topic for topic in image_names(name) if topic in topics]
    for topic in found:
        if topics[topic].msgtype in IMAGE_TYPES:
            return topic
    if found:
        raise BagError(f"bag {_names(bags)}: {found[0]} holds {topics[found[0]].msgtype}, not {IMAGE_TYPES[0]}")
    raise _missing_topic(bags, topics, " or ".join(image_names(name)))


def _missing_topic(bags: Sequence[Path], topics: dict[str, TopicInfo], topic: str) -> BagError:
    folder = f"/{topic.split('/')[1]}/"
    own = sorted(t for t in topics if t.startswith(folder))
    there = f"below {folder} it holds {', '.join(own)}" if own else f"it holds {', '.join(sorted(topics)) or 'nothing'}"
    remedy = "set input.calibration" if topic == TF_STATIC else "set input.topics"
    remedy += ", or input.calibration" if topic.endswith("camera_info") else ""
    return BagError(f"bag {_names(bags)} lacks {topic}; {there}; record that topic, or {remedy}")


def _collect(bags: Sequence[Path], topics: dict[str, TopicInfo], setup: SensorSetup) -> None:
    """Read all static transforms, and camera infos until all that is needed is known, or the recording ends."""
    for raw in _readable(iter_raw(bags, [TF_STATIC])) if TF_STATIC in topics else ():
        setup.frames.add(transforms_of(decode(raw)))
    sides = {setup.config.topic(setup.vehicle, f"{side}_info"): side for side in SIDES}
    for raw in _readable(iter_raw(bags, [topic for topic in sides if topic in topics])):
        if not setup.missing_infos:
            return
        if sides[raw.topic] not in setup.cameras:
            try:
                setup.add_camera(sides[raw.topic], decode(raw))
            except CalibrationError as error:
                raise CalibrationError(f"{raw.topic}: {error}") from None
    for side in setup.missing_infos:
        topic = setup.config.topic(setup.vehicle, f"{side}_info")
        raise BagError(f"bag {_names(bags)} holds no message on {topic}; record it with the images")


def unmoved_edges(bags: Sequence[Path]) -> list[Edge]:
    """Return the edges (parent frame, child frame, T_parent_child) of /tf that never change."""
    found = UnmovedFrames()
    for raw in _readable(iter_raw(bags, [TF])):
        with suppress(CalibrationError):  # of another frame
            found.add(transforms_of(decode(raw)))
    return found.edges


def _first(bags: Sequence[Path], topic: str) -> Any:
    """Return a topic's first message, None if there is none."""
    first = next(_readable(iter_raw(bags, [topic])), None)
    return decode(first) if first else None


def _names(bags: Sequence[Path]) -> str:
    return ", ".join(map(str, bags))


def _readable(messages: Iterator[RawMessage]) -> Iterator[RawMessage]:
    """Yield the readable messages; damage is ignored here, because replay reports it."""
    try:
        yield from messages
    except BagError:
        return


def _in_stamp_order(events: Iterator[ImuSample | StereoFrame]) -> Iterator[ImuSample | StereoFrame]:
    """Sort late events within a window; a damaged recording's readable events precede its error."""
    waiting: list[tuple[int, bool, int, ImuSample | StereoFrame]] = []
    newest = 0
    error: BagError | None = None
    try:
        for number, event in enumerate(events):
            if event.stamp_ns < newest - REORDER_NS:  # the clock was set back: what came before precedes it
                yield from (entry[-1] for entry in sorted(waiting))
                waiting.clear()
                newest = event.stamp_ns
            newest = max(newest, event.stamp_ns)
            heapq.heappush(waiting, (event.stamp_ns, isinstance(event, StereoFrame), number, event))
            while waiting[0][0] <= newest - REORDER_NS:
                yield heapq.heappop(waiting)[-1]
    except BagError as broken:
        error = broken
    while waiting:
        yield heapq.heappop(waiting)[-1]
    if error is not None:
        raise error
