# SPDX-License-Identifier: Apache-2.0
"""Reads one vehicle's flight from bags: calibration, start state, ground truth, sensor events in stamp order."""

import heapq
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uav_vslam.datasets.flight_writer import TF_STATIC
from uav_vslam.datasets.messages import (
    TruthSample,
    camera_of,
    image_of,
    imu_of,
    navigation_state_of,
    stamp_ns_of,
    transforms_of,
    truth_of,
)
from uav_vslam.datasets.rosbag import RawMessage, RawRecorder, TopicInfo, decode, iter_raw, topics_of
from uav_vslam.datasets.stereo_sync import StereoPairer
from uav_vslam.errors import BagError, CalibrationError
from uav_vslam.geometry.camera import PinholeCamera
from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.stereo import StereoRig
from uav_vslam.types import ImuSample, NavEstimate, StereoFrame

__all__ = ["BagFlight", "RawMessage", "RawRecorder", "TruthTrack", "iter_raw", "open_flight", "topics_of", "vehicles"]

Array = NDArray[np.float64]

IMAGE_TOPICS = ("image_raw", "image_raw/compressed")
REORDER_NS = 500_000_000  # a message may be recorded this much later than its stamp


@dataclass(frozen=True, slots=True)
class TruthTrack:
    """True motion, in stamp order.

    Attributes:
        stamps_ns: (N,) int64 [ns].
        positions_world: (N, 3) [m].
        R_world_body: (N, 3, 3).
        velocities_world: (N, 3) [m/s].
    """

    stamps_ns: NDArray[np.int64]
    positions_world: Array
    R_world_body: Array
    velocities_world: Array

    def __len__(self) -> int:
        return len(self.stamps_ns)


@dataclass(frozen=True, slots=True)
class BagFlight:
    """One vehicle's recording.

    Attributes:
        paths: the bags.
        vehicle: ROS namespace, without slashes at its ends.
        rig: calibration.
        initial_state: start state, or None if none was recorded.
        frame_count: left images recorded.
        left_topic, right_topic: of the images.
    """

    paths: tuple[Path, ...]
    vehicle: str
    rig: StereoRig
    initial_state: NavEstimate | None
    frame_count: int
    left_topic: str
    right_topic: str

    @property
    def image_size(self) -> tuple[int, int]:
        """Width and height of both images [px]."""
        return self.rig.left.width, self.rig.left.height

    def iter_events(self, *, tolerance_ns: int = 2_000_000) -> Iterator[ImuSample | StereoFrame]:
        """Yield IMU samples and image pairs in stamp order; at equal stamps the sample comes first.

        Args:
            tolerance_ns: largest stamp difference of a pair [ns].

        Raises:
            BagError: the recording is damaged (raised after all readable events), or a message can't be decoded. An
                undecodable image becomes an empty one: its frame has no points.
        """
        return _in_stamp_order(self._recorded_events(tolerance_ns))

    def truth(self) -> TruthTrack | None:
        """Return the true motion, or None if none was recorded.

        Raises:
            BagError: a message can't be decoded, or its quaternion is invalid.
        """
        topic = f"/{self.vehicle}/ground_truth/odometry"
        try:
            samples = [truth_of(decode(raw)) for raw in _readable(iter_raw(self.paths, [topic]))]
        except ValueError as error:
            raise BagError(f"bag {_names(self.paths)}, {topic}: {error}") from None
        return _track(samples) if samples else None

    def _recorded_events(self, tolerance_ns: int) -> Iterator[ImuSample | StereoFrame]:
        imu_topic = f"/{self.vehicle}/imu/data_raw"
        pairer: StereoPairer[Any] = StereoPairer(tolerance_ns=tolerance_ns)
        for raw in iter_raw(self.paths, [imu_topic, self.left_topic, self.right_topic]):
            built = decode(raw)
            if raw.topic == imu_topic:
                yield imu_of(built)
                continue
            add = pairer.add_left if raw.topic == self.left_topic else pairer.add_right
            pair = add(stamp_ns_of(built), built)
            if pair is not None:
                yield StereoFrame(pair.stamp_ns, _pixels_or_empty(pair.left), _pixels_or_empty(pair.right))

    def check_images(self) -> None:
        """Decode the first image of each side, to fail early where `iter_events` would fail.

        Raises:
            BagError: it is missing or can't be decoded.
            CalibrationError: it is not of the size that camera_info states.
        """
        for topic in (self.left_topic, self.right_topic):
            first = next(_readable(iter_raw(self.paths, [topic])), None)
            if first is None:
                raise BagError(f"bag {_names(self.paths)} holds no message on {topic}; record the images")
            height, width = image_of(decode(first)).shape[:2]
            if (width, height) != self.image_size:
                raise CalibrationError(
                    f"bag {_names(self.paths)}: images on {topic} are {width}x{height} px but camera_info says "
                    f"{self.image_size[0]}x{self.image_size[1]}; calibrate at the recorded size"
                )


def _pixels_or_empty(built: Any) -> NDArray[Any]:
    try:
        return image_of(built)
    except BagError:
        return np.zeros((0, 0), np.uint8)


def vehicles(paths: Sequence[Path]) -> list[str]:
    """Return the namespaces that have left images, sorted."""
    endings = [f"/left/{name}" for name in IMAGE_TOPICS]
    topics = topics_of(paths)
    return sorted({topic.removesuffix(end).strip("/") for topic in topics for end in endings if topic.endswith(end)})


def open_flight(paths: Path | Sequence[Path], vehicle: str) -> BagFlight:
    """Read what is constant during a flight: calibration, start state and topic names.

    Args:
        paths: bags that together hold the vehicle's topics.
        vehicle: its ROS namespace.

    Raises:
        BagError: a path is missing or not a bag, or a topic or the extrinsics are missing.
        CalibrationError: the cameras' calibrations contradict each other.
    """
    bags = (paths,) if isinstance(paths, Path) else tuple(paths)
    topics = topics_of(bags)
    name = vehicle.strip("/")
    left_topic, right_topic = (_image_topic(bags, topics, name, side) for side in ("left", "right"))
    for topic in (f"/{name}/left/camera_info", f"/{name}/right/camera_info", f"/{name}/imu/data_raw", TF_STATIC):
        if topic not in topics:
            raise _missing_topic(bags, topics, name, topic)
    rig, initial = _calibration(bags, name, has_initial=f"/{name}/initial_state" in topics)
    return BagFlight(bags, name, rig, initial, topics[left_topic].count, left_topic, right_topic)


def _image_topic(bags: Sequence[Path], topics: dict[str, TopicInfo], name: str, side: str) -> str:
    for ending in IMAGE_TOPICS:
        if f"/{name}/{side}/{ending}" in topics:
            return f"/{name}/{side}/{ending}"
    raise _missing_topic(bags, topics, name, f"/{name}/{side}/image_raw (or .../compressed)")


def _missing_topic(bags: Sequence[Path], topics: dict[str, TopicInfo], name: str, topic: str) -> BagError:
    own = sorted(t for t in topics if t.startswith(f"/{name}/"))
    there = ", ".join(own or sorted(topics)) or "nothing"
    return BagError(f"bag {_names(bags)} lacks {topic}; it holds {there}; record or remap that topic")


def _calibration(bags: Sequence[Path], name: str, *, has_initial: bool) -> tuple[StereoRig, NavEstimate | None]:
    """Read the first camera infos, the static transforms and the start state; stop as soon as all are found."""
    left_topic, right_topic = f"/{name}/left/camera_info", f"/{name}/right/camera_info"
    initial_topic = f"/{name}/initial_state"
    found: dict[str, Any] = {}
    edges: dict[str, tuple[str, Pose]] = {}
    wanted = [left_topic, right_topic, TF_STATIC, *([initial_topic] if has_initial else [])]
    for raw in _readable(iter_raw(bags, wanted)):
        built = decode(raw)
        found.setdefault(raw.topic, built)
        if raw.topic == TF_STATIC:
            edges.update({child: (parent, pose) for parent, child, pose in transforms_of(built)})
        if len(found) == len(wanted) and _has_extrinsics(edges, found, name, (left_topic, right_topic)):
            break
    for topic in (left_topic, right_topic):
        if topic not in found:
            raise BagError(f"bag {_names(bags)} holds no message on {topic}; record it with the images")
    poses = [_extrinsics(edges, found[t].header.frame_id, name) for t in (left_topic, right_topic)]
    cameras = [_camera(bags, topic, found[topic]) for topic in (left_topic, right_topic)]
    try:
        rig = StereoRig(cameras[0], cameras[1], poses[0], poses[1])
    except CalibrationError as error:
        raise CalibrationError(f"bag {_names(bags)}, vehicle {name}: {error}") from None
    initial = navigation_state_of(found[initial_topic]) if initial_topic in found else None
    return rig, initial


def _camera(bags: Sequence[Path], topic: str, info: Any) -> PinholeCamera:
    try:
        return camera_of(info)
    except (BagError, CalibrationError) as error:
        raise type(error)(f"bag {_names(bags)}, {topic}: {error}") from None


def _names(bags: Sequence[Path]) -> str:
    return ", ".join(map(str, bags))


def _has_extrinsics(edges: dict[str, tuple[str, Pose]], found: dict[str, Any], name: str, infos: Sequence[str]) -> bool:
    return all(walk(edges, found[t].header.frame_id, f"{name}/base_link") is not None for t in infos)


def _extrinsics(edges: dict[str, tuple[str, Pose]], frame_id: str, name: str) -> Pose:
    pose = walk(edges, frame_id, f"{name}/base_link")
    if pose is None:
        there = ", ".join(f"{parent} -> {child}" for child, (parent, _) in sorted(edges.items())) or "nothing"
        raise BagError(
            f"/tf_static does not connect {name}/base_link and {frame_id}; it holds {there}; "
            "publish the camera's extrinsics"
        )
    return pose


def walk(edges: dict[str, tuple[str, Pose]], frame_id: str, base: str) -> Pose | None:
    """Return T_base_frame along a tree of child -> (parent, T_parent_child), or None if they are not connected."""
    frame, pose = frame_id.lstrip("/"), Pose.identity()
    for _ in range(len(edges) + 1):
        if frame == base:
            return pose
        if frame not in edges:
            return None
        parent, T_parent_child = edges[frame]
        frame, pose = parent, T_parent_child @ pose
    return None


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


def _track(samples: list[TruthSample]) -> TruthTrack:
    samples = sorted({sample.stamp_ns: sample for sample in samples}.values(), key=lambda s: s.stamp_ns)
    return TruthTrack(
        np.array([s.stamp_ns for s in samples], dtype=np.int64),
        np.array([s.T_world_body.t for s in samples]),
        np.array([s.T_world_body.R for s in samples]),
        np.array([s.v_world for s in samples]),
    )
