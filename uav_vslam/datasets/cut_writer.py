# SPDX-License-Identifier: Apache-2.0
"""Writes legs of one recording as a bag of several vehicles that fly at the same time.

Readings and images keep their content, bit for bit; stamps, topics and frames change. The calibration is that which
the configuration gives the recording, so the new bag has the conventional topics and needs no `input`.
"""

import dataclasses
import heapq
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from uav_vslam.config import InputConfig, StartConfig, VehicleConfig, parameter_file
from uav_vslam.config.input import COMPRESSED
from uav_vslam.datasets.bag_flight import BagFlight
from uav_vslam.datasets.bag_recorder import RawRecorder
from uav_vslam.datasets.cdr import RawMessage, decode
from uav_vslam.datasets.cutting import CutVehicle
from uav_vslam.datasets.flight_writer import camera_edges, record_message
from uav_vslam.datasets.frame_tree import TF_STATIC
from uav_vslam.datasets.message_builders import (
    camera_info_message,
    navigation_state_message,
    transforms_message,
    truth_message,
    with_header,
)
from uav_vslam.datasets.messages import TruthSample, header_stamp_ns
from uav_vslam.datasets.seen_points import Unread, readable, recorded_pairs
from uav_vslam.datasets.truth_track import TruthTrack
from uav_vslam.datasets.unfinished import unfinished
from uav_vslam.errors import BagError
from uav_vslam.evaluation.pairing import MAX_GAP_S
from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.stereo import SIDES
from uav_vslam.types import NS_PER_S

FLEET_FILE, CONFIG_FILE = "fleet.yaml", "vehicle.yaml"
MARGIN_NS = NS_PER_S // 10  # readings begin this long before the first frame and end after the last

Message = tuple[int, str, Any]  # stamp [ns], topic, message


def write_cut(
    out: Path,
    flight: BagFlight,
    vehicles: Sequence[CutVehicle],
    config: VehicleConfig,
    on_frame: Callable[[], None] = lambda: None,
    *,
    with_truth: bool = True,
) -> Unread:
    """Write the vehicles' bag, with a fleet file for `run` and `launch` inside; an interrupted one leaves nothing.

    Args:
        out: bag folder to make.
        flight: the source.
        vehicles: which legs, and what they become.
        config: of the source's vehicle.
        on_frame: called for each image pair written.
        with_truth: copy the ground truth, if the starts are in its frame.

    Returns:
        What could not be read of the source, and is left out.

    Raises:
        BagError: the folder exists or can't be made.
    """
    unread = Unread()
    with unfinished(out) as folder:
        with RawRecorder(folder) as recorder:
            _write_all(recorder, flight, vehicles, flight.truth() if with_truth else None, unread, on_frame)
        _write_fleet_file(folder, [vehicle.name for vehicle in vehicles], config)
    return unread


def _write_all(
    recorder: RawRecorder,
    flight: BagFlight,
    vehicles: Sequence[CutVehicle],
    truth: TruthTrack | None,
    unread: Unread,
    on_frame: Callable[[], None],
) -> None:
    streams = [_stream(flight, vehicle, truth, unread) for vehicle in vehicles]
    first = True
    for stamp_ns, topic, built in heapq.merge(*streams, key=lambda message: message[0]):
        if first:
            record_message(recorder, TF_STATIC, _transforms(flight, vehicles, stamp_ns), stamp_ns)
            first = False
        record_message(recorder, topic, built, stamp_ns)
        if topic.endswith("left/camera_info"):
            on_frame()


def _transforms(flight: BagFlight, vehicles: Sequence[CutVehicle], stamp_ns: int) -> Any:
    edges = []
    for vehicle in vehicles:
        edges += camera_edges(vehicle.name, flight.rig)
        base, imu = f"{vehicle.name}/base_link", _imu_frame(flight, vehicle)
        if imu != base:
            edges.append((base, imu, flight.T_body_imu))
    return transforms_message(stamp_ns, edges)


def _imu_frame(flight: BagFlight, vehicle: CutVehicle) -> str:
    """Return the frame of a vehicle's readings, which stay in the axes of the source's IMU."""
    is_body = np.array_equal(flight.T_body_imu.matrix, np.eye(4))
    return f"{vehicle.name}/{'base_link' if is_body else 'imu'}"


def _stream(flight: BagFlight, vehicle: CutVehicle, truth: TruthTrack | None, unread: Unread) -> Iterator[Message]:
    """Yield a vehicle's messages, stamped as recorded when they were measured."""
    streams = [_images(flight, vehicle, unread), _readings(flight, vehicle, unread)]
    if truth is not None:
        streams.append(_truth(vehicle, truth))
    return heapq.merge(*streams, key=lambda message: message[0])


def _images(flight: BagFlight, vehicle: CutVehicle, unread: Unread) -> Iterator[Message]:
    """Yield the start state, then each pair that can be decoded with its calibration."""
    cameras = dict(zip(SIDES, (flight.rig.left, flight.rig.right), strict=True))
    topic, frame_id = f"/{vehicle.name}", f"{vehicle.name}/{{}}_optical"
    for pair in recorded_pairs(flight, unread):
        if not vehicle.first_ns <= pair.stamp_ns <= vehicle.last_ns:
            continue
        pair_ns = pair.stamp_ns + vehicle.shift_ns
        if pair.stamp_ns == vehicle.first_ns:
            yield pair_ns, f"{topic}/initial_state", _start(vehicle)
        images = [image for raw in (pair.left, pair.right) if (image := _decoded(raw, unread)) is not None]
        if len(images) < len(SIDES):
            continue
        for side, raw, image in zip(SIDES, (pair.left, pair.right), images, strict=True):
            stamp_ns = header_stamp_ns(raw.data) + flight.time_offset_ns + vehicle.shift_ns
            frame = frame_id.format(side)
            yield pair_ns, f"{topic}/{side}/camera_info", camera_info_message(stamp_ns, frame, cameras[side])
            name = f"{topic}/{side}/image_raw{COMPRESSED if raw.msgtype.endswith('CompressedImage') else ''}"
            yield pair_ns, name, with_header(image, stamp_ns, frame)


def _decoded(raw: RawMessage, unread: Unread) -> Any:
    """Return the message, None if it can't be read."""
    try:
        return decode(raw)
    except BagError as error:
        unread.add(raw, error)
        return None


def _start(vehicle: CutVehicle) -> Any:
    state = dataclasses.replace(vehicle.start.state, stamp_ns=vehicle.first_ns + vehicle.shift_ns)
    moved = dataclasses.replace(vehicle.start, state=state)
    return navigation_state_message(moved, vehicle.name)


def _readings(flight: BagFlight, vehicle: CutVehicle, unread: Unread) -> Iterator[Message]:
    frame = _imu_frame(flight, vehicle)
    topics = [flight.input.topic(flight.vehicle, "imu"), *flight.input.gyro_topics(flight.vehicle)]
    for source_ns, raw in readable(flight, topics, unread):
        stamp_ns = source_ns + vehicle.shift_ns
        if not vehicle.first_ns - MARGIN_NS <= source_ns <= vehicle.last_ns + MARGIN_NS:
            continue
        reading = _decoded(raw, unread)
        if reading is not None:
            yield stamp_ns, f"/{vehicle.name}/imu/data_raw", with_header(reading, stamp_ns, frame)


def _truth(vehicle: CutVehicle, truth: TruthTrack) -> Iterator[Message]:
    """Yield the truth as `nav_msgs/Odometry`, whatever it was; its angular rate, which nothing reads, as unknown."""
    margin_ns = round(MAX_GAP_S * NS_PER_S)
    first, last = np.searchsorted(truth.stamps_ns, [vehicle.first_ns - margin_ns, vehicle.last_ns + margin_ns])
    for k in range(first, last):
        stamp_ns = int(truth.stamps_ns[k]) + vehicle.shift_ns
        pose = Pose(truth.R_world_body[k], truth.positions_world[k])
        sample = TruthSample(stamp_ns, pose, truth.velocities_world[k], np.full(3, np.nan))
        yield stamp_ns, f"/{vehicle.name}/ground_truth/odometry", truth_message(sample, vehicle.name)


def _write_fleet_file(folder: Path, names: list[str], config: VehicleConfig) -> None:
    """Write the source's settings, without those of its topics, calibration and own frames, for `run` and `launch`."""
    settings = dataclasses.replace(
        config,
        input=InputConfig(pair_tolerance_s=config.input.pair_tolerance_s),
        frames=dataclasses.replace(config.frames, map="", odom=""),  # two vehicles can't share them
        start=StartConfig(),
    )
    fleet = {"vehicles": {name: {"config": CONFIG_FILE} for name in names}, "replay": {"bags": ["."]}}
    for name, tree in ((CONFIG_FILE, parameter_file({"/**": settings})), (FLEET_FILE, fleet)):
        (folder / name).write_text(yaml.safe_dump(tree, sort_keys=False), encoding="utf-8")
