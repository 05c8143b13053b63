# SPDX-License-Identifier: Apache-2.0
"""One vehicle's flight in bags: sensor events in stamp order, ground truth, images."""

import dataclasses
import heapq
import itertools
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uav_vslam.config import InputConfig
from uav_vslam.datasets.cdr import RawMessage, decode
from uav_vslam.datasets.messages import (
    TRUTH_TYPES,
    header_stamp_ns,
    image_of,
    imu_of,
    stamp_ns_of,
    truth_of,
)
from uav_vslam.datasets.rosbag import iter_raw, iter_readable, names_of
from uav_vslam.datasets.stereo_sync import LATE_NS, PairTolerance, StereoPairer, nearest_offsets_ns
from uav_vslam.datasets.truth_track import TruthSeries, TruthTrack
from uav_vslam.datasets.united_imu import united
from uav_vslam.errors import BagError, CalibrationError, InvalidMessage
from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.stereo import StereoRig
from uav_vslam.ins.mounting import ImuMounting
from uav_vslam.types import NS_PER_S, ImuSample, NavEstimate, StereoFrame

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
            BagError: the recording is damaged or messages can't be decoded (raised after all readable events). An
                image of an unknown encoding becomes an empty one: its frame has no points.
        """
        return in_stamp_order(self._recorded_events())

    def truth(self) -> TruthTrack | None:
        """Return the true motion, maybe without any pose that can be used; None if none was recorded."""
        samples, left_out = TruthSeries(), 0
        for raw in iter_readable(self.paths, [self.input.topic(self.vehicle, "truth")]):
            if raw.msgtype not in TRUTH_TYPES:
                return None
            try:
                samples.add(truth_of(decode(raw)))
            except (BagError, InvalidMessage):
                left_out += 1
        return dataclasses.replace(samples.track(), left_out=left_out) if samples or left_out else None

    def stamps_apart_ns(self, first: int | None = None) -> NDArray[np.int64]:
        """Return the distance of each left image's stamp to the nearest right one's [ns].

        Args:
            first: only of so many images; None for all.
        """
        left, right = (self._stamps_ns(topic, first) for topic in (self.left_topic, self.right_topic))
        return np.abs(nearest_offsets_ns(left, right))

    def pair_tolerance_ns(self, first: int) -> int:
        """Return the largest difference between the stamps of a pair [ns], after the first so many left images."""
        tolerance = PairTolerance(round(self.input.pair_tolerance_s * NS_PER_S))
        for stamp_ns in self._stamps_ns(self.left_topic, first):
            tolerance.add_left(int(stamp_ns))
        return tolerance.ns

    def unpaired_reason(self) -> str:
        """Return why images found no partner, from the stamps of both cameras."""
        left, right = (self._stamps_ns(topic, None) for topic in (self.left_topic, self.right_topic))
        for topic, stamps_ns in ((self.left_topic, left), (self.right_topic, right)):
            if (repeated := len(stamps_ns) - len(np.unique(stamps_ns))) > len(stamps_ns) / 2:
                return f"{repeated} of {len(stamps_ns)} stamps of {topic} are repeated: let its driver set them"
        apart = np.abs(nearest_offsets_ns(left, right))
        if len(apart) == 0:
            return f"{self.left_topic} or {self.right_topic} holds no image"
        nearest_are = f"the nearest stamps of {self.left_topic} and {self.right_topic} are"
        if np.median(apart) > LATE_NS:
            return (
                f"{nearest_are} {np.median(apart) / NS_PER_S:.3g} s apart (median): their clocks differ; use one clock"
            )
        return f"{nearest_are} {np.median(apart) / 1e6:.3g} ms apart (median); see input.pair_tolerance_s"

    def _stamps_ns(self, topic: str, first: int | None) -> NDArray[np.int64]:
        images = itertools.islice(self._stamped_images(topic), first)
        return np.array([stamp_ns for stamp_ns, _ in images], np.int64)

    def left_images(self, stamps_ns: Collection[int]) -> Iterator[tuple[int, NDArray[Any]]]:
        """Yield stamp and pixels of the left images of some frames, as recorded; undecodable ones are left out.

        Args:
            stamps_ns: of the frames, as `iter_events` has them.
        """
        for recorded_ns, raw in self._stamped_images(self.left_topic):
            stamp_ns = recorded_ns + self.time_offset_ns
            if stamp_ns in stamps_ns:
                try:
                    pixels = image_of(decode(raw))
                except BagError:
                    continue
                yield stamp_ns, pixels

    def _stamped_images(self, topic: str) -> Iterator[tuple[int, RawMessage]]:
        """Yield images with the stamps of their headers [ns]; those too short for one are left out."""
        for raw in iter_readable(self.paths, [topic]):
            try:
                stamp_ns = header_stamp_ns(raw.data)
            except BagError:
                continue
            yield stamp_ns, raw

    def _recorded_events(self) -> Iterator[ImuSample | StereoFrame]:
        imu_topic = self.input.topic(self.vehicle, "imu")
        mounting = ImuMounting(self.T_body_imu)
        pairer: StereoPairer[Any] = StereoPairer(tolerance_ns=round(self.input.pair_tolerance_s * NS_PER_S))
        refused: list[BagError] = []
        gyro_topics = self.input.gyro_topics(self.vehicle)
        recorded = iter_raw(self.paths, [imu_topic, *gyro_topics, self.left_topic, self.right_topic])
        for raw in united(recorded, gyro_topics):
            try:
                built = decode(raw)
            except BagError as error:
                refused.append(error)
                continue
            if raw.topic == imu_topic:
                yield mounting.to_body(imu_of(built))
                continue
            side = "left" if raw.topic == self.left_topic else "right"
            pair = pairer.add(side, stamp_ns_of(built), built)
            if pair is not None:
                stamp_ns = pair.stamp_ns + self.time_offset_ns
                yield StereoFrame(stamp_ns, _pixels_or_empty(pair.left), _pixels_or_empty(pair.right))
        if refused:
            raise BagError(
                f"bag {names_of(self.paths)}: {len(refused)} messages can't be read and were left out, the first: "
                f"{refused[0]}; correct what writes them"
            )

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
                    f"bag {names_of(self.paths)}: images on {topic} are {width}x{height} px but the calibration says "
                    f"{self.image_size[0]}x{self.image_size[1]}; calibrate at the recorded size, or give K for it: "
                    "binning and region of interest of a camera_info are applied to K, which is the whole sensor's"
                )

    def _first_pixels(self, topic: str) -> NDArray[Any]:
        """Return the first image that can be decoded: a camera's first exposure may fail, as any later one may."""
        refused = ""
        for raw in itertools.islice(iter_readable(self.paths, [topic]), TRIED_IMAGES):
            try:
                return image_of(decode(raw))
            except BagError as error:
                refused = refused or str(error)
        if not refused:
            raise BagError(f"bag {names_of(self.paths)} holds no message on {topic}; record the images")
        raise BagError(f"bag {names_of(self.paths)}, {topic}: {refused}")


def _pixels_or_empty(built: Any) -> NDArray[Any]:
    try:
        return image_of(built)
    except BagError:
        return np.zeros((0, 0), np.uint8)


def in_stamp_order(events: Iterator[ImuSample | StereoFrame]) -> Iterator[ImuSample | StereoFrame]:
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
