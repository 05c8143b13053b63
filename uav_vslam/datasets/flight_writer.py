# SPDX-License-Identifier: Apache-2.0
"""Writes flights as bags for the node graph, `ros2 bag play` and `open_flight`."""

import heapq
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from uav_vslam.datasets.bag_recorder import RawRecorder
from uav_vslam.datasets.cdr import encoded_view
from uav_vslam.datasets.frame_tree import TF_STATIC
from uav_vslam.datasets.message_builders import (
    camera_info_message,
    compressed_image_message,
    image_message,
    imu_message,
    navigation_state_message,
    transforms_message,
    truth_message,
)
from uav_vslam.datasets.messages import TruthSample
from uav_vslam.errors import BagError
from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.stereo import StereoRig
from uav_vslam.types import ImuSample, NavEstimate, StereoFrame

LATCHED_TOPICS = (TF_STATIC, "initial_state")

# Order of messages with equal stamps: subscribers need the start state before the image.
INITIAL, TRUTH, IMU, CAMERAS = range(4)

Event = tuple[int, int, Callable[[], Iterator[tuple[str, Any]]]]  # stamp, rank, and a factory of (topic, message)


@dataclass(frozen=True, slots=True)
class SourceImage:
    """An image as its file has it, recorded without another encoding.

    Attributes:
        stamp_ns: exposure time [ns].
        content: bytes of a jpeg or png file, or (H, W) grey or (H, W, 3) BGR pixels.
        fmt: of bytes, "jpeg" or "png".
        encoding: of a Bayer mosaic, "bayer_rggb8"; empty if the pixels are grey or colour.
    """

    stamp_ns: int
    content: bytes | NDArray[np.generic]
    fmt: str = ""
    encoding: str = ""


@dataclass(frozen=True, slots=True)
class SourceFrame:
    """An image pair as its files have it."""

    left: SourceImage
    right: SourceImage

    @property
    def stamp_ns(self) -> int:
        """Stamp of the left image [ns]."""
        return self.left.stamp_ns


@dataclass(frozen=True, slots=True)
class ImageCoding:
    """How images are recorded.

    Attributes:
        fmt: "raw", "png" or "jpeg".
        quality: of jpeg, 1 to 100.
    """

    fmt: str = "raw"
    quality: int = 90

    def __post_init__(self) -> None:
        if self.fmt not in {"raw", "png", "jpeg"} or not 1 <= self.quality <= 100:
            raise BagError(f"image coding {self.fmt!r} at quality {self.quality}: use raw, png or jpeg and 1 to 100")


@dataclass(frozen=True, slots=True)
class FlightRecording:
    """One vehicle's recording; each stream is in stamp order and is iterated once.

    Attributes:
        vehicle: ROS namespace.
        rig: calibration; it goes into camera_info and /tf_static.
        imu, truth, frames: streams.
        initial: start state, or None.
    """

    vehicle: str
    rig: StereoRig
    imu: Iterable[ImuSample]
    truth: Iterable[TruthSample]
    frames: Iterable[StereoFrame | SourceFrame]
    initial: NavEstimate | None


def write_flights(
    path: Path,
    flights: list[FlightRecording],
    *,
    coding: ImageCoding | None = None,
    storage: str = "mcap",
    zstd: bool = False,
    on_frame: Callable[[], None] = lambda: None,
) -> int:
    """Record one or more vehicles into one bag, in stamp order.

    Args:
        path: bag folder to make.
        flights: the vehicles.
        coding: how images are stored; images of files are kept as they are.
        storage: "mcap" or "sqlite3".
        zstd: compress the chunks of an mcap file.
        on_frame: called after each image pair, for a progress bar.

    Returns:
        How many image pairs were recorded.

    Raises:
        BagError: the folder exists, or our message definitions are not found.
    """
    coding = coding or ImageCoding()
    with RawRecorder(path, storage=storage, zstd=zstd) as recorder:
        first, pairs = True, 0
        streams = [_events(flight, coding) for flight in flights]
        for stamp_ns, rank, make in heapq.merge(*streams, key=lambda event: event[:2]):
            if first:
                record_message(recorder, TF_STATIC, _transforms(flights, stamp_ns), stamp_ns)
                first = False
            for topic, built in make():
                record_message(recorder, topic, built, stamp_ns)
            if rank == CAMERAS:
                pairs += 1
                on_frame()
    return pairs


def record_message(recorder: RawRecorder, topic: str, built: Any, stamp_ns: int) -> None:
    """Write a message made by `cdr.message`, for late subscribers too if its topic is a latched one."""
    recorder.write(topic, built.__msgtype__, encoded_view(built), stamp_ns, latched=topic.endswith(LATCHED_TOPICS))


def _transforms(flights: list[FlightRecording], stamp_ns: int) -> Any:
    edges = [edge for flight in flights for edge in camera_edges(flight.vehicle, flight.rig)]
    return transforms_message(stamp_ns, edges)


def camera_edges(vehicle: str, rig: StereoRig) -> list[tuple[str, str, Pose]]:
    """Return the places of both cameras as (parent frame, child frame, T_parent_child)."""
    base = f"{vehicle}/base_link"
    return [(base, f"{vehicle}/left_optical", rig.T_body_left), (base, f"{vehicle}/right_optical", rig.T_body_right)]


def _events(flight: FlightRecording, coding: ImageCoding) -> Iterator[Event]:
    """Yield one vehicle's events in stamp order; messages are built (and images encoded) only when recorded."""
    streams: list[Iterable[Event]] = [
        ((s.stamp_ns, TRUTH, partial(_truth, flight, s)) for s in flight.truth),
        ((s.stamp_ns, IMU, partial(_imu, flight, s)) for s in flight.imu),
        ((f.stamp_ns, CAMERAS, partial(_cameras, flight, f, coding)) for f in flight.frames),
    ]
    if flight.initial is not None:
        streams.append([(flight.initial.state.stamp_ns, INITIAL, partial(_initial, flight))])
    yield from heapq.merge(*streams, key=lambda event: event[:2])


def _initial(flight: FlightRecording) -> Iterator[tuple[str, Any]]:
    assert flight.initial is not None
    yield f"/{flight.vehicle}/initial_state", navigation_state_message(flight.initial, flight.vehicle)


def _truth(flight: FlightRecording, sample: TruthSample) -> Iterator[tuple[str, Any]]:
    yield f"/{flight.vehicle}/ground_truth/odometry", truth_message(sample, flight.vehicle)


def _imu(flight: FlightRecording, sample: ImuSample) -> Iterator[tuple[str, Any]]:
    yield f"/{flight.vehicle}/imu/data_raw", imu_message(sample, f"{flight.vehicle}/base_link")


def _cameras(
    flight: FlightRecording, frame: StereoFrame | SourceFrame, coding: ImageCoding
) -> Iterator[tuple[str, Any]]:
    for side, camera, picture in (
        ("left", flight.rig.left, frame.left),
        ("right", flight.rig.right, frame.right),
    ):
        frame_id = f"{flight.vehicle}/{side}_optical"
        image = picture if isinstance(picture, SourceImage) else _coded(frame.stamp_ns, picture, coding)
        yield f"/{flight.vehicle}/{side}/camera_info", camera_info_message(image.stamp_ns, frame_id, camera)
        topic, built = _image(image, frame_id)
        yield f"/{flight.vehicle}/{side}/{topic}", built


def _image(image: SourceImage, frame_id: str) -> tuple[str, Any]:
    """Return the topic, relative to the camera's, and the message."""
    if not isinstance(image.content, bytes):
        return "image_raw", image_message(image.stamp_ns, frame_id, image.content, encoding=image.encoding)
    fmt = f"{image.encoding}; {image.fmt} compressed" if image.encoding else image.fmt
    return "image_raw/compressed", compressed_image_message(image.stamp_ns, frame_id, image.content, fmt=fmt)


def _coded(stamp_ns: int, pixels: NDArray[np.generic], coding: ImageCoding) -> SourceImage:
    if coding.fmt == "raw":
        return SourceImage(stamp_ns, pixels)
    png = coding.fmt == "png"
    option = [cv2.IMWRITE_PNG_COMPRESSION, 3] if png else [cv2.IMWRITE_JPEG_QUALITY, coding.quality]
    _, data = cv2.imencode(f".{coding.fmt}", pixels, option)
    return SourceImage(stamp_ns, bytes(data), coding.fmt)
