# SPDX-License-Identifier: Apache-2.0
"""All that `uav-vslam bench` measures."""

import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2

from uav_vslam.datasets.bag import open_flight
from uav_vslam.datasets.flight_writer import FlightRecording, write_flights
from uav_vslam.simulation.scenario import SimulatedVehicle
from uav_vslam.slam.packet import ANCHOR, PacketPolicy
from uav_vslam.studies.bench import back_end, matching, stages
from uav_vslam.studies.bench.stages import take_turns
from uav_vslam.studies.engine.study import Row
from uav_vslam.types import StereoFrame
from uav_vslam.vision.compact_descriptors import COMPACT


@dataclass(frozen=True, slots=True)
class Effort:
    """How thoroughly to measure.

    Attributes:
        pairs: image pairs.
        frames: frames of the back end, after its warm-up.
        repeats: of everything that takes a few milliseconds or less.
    """

    pairs: int = 31
    frames: int = 95
    repeats: int = 100


QUICK = Effort(pairs=2, frames=3, repeats=3)


def measure(effort: Effort) -> Iterator[Row]:
    """Yield a row per stage and condition."""
    vehicle, frames = stages.rendered_frames(effort.pairs)
    few = frames[:8]  # enough where each frame is measured by itself
    yield stages.stereo_front_end(vehicle, few, _sift())
    yield stages.live_front_end(vehicle, frames, _sift())
    yield from matching.graph_matching(2000, min(effort.repeats, 10))
    for landmarks in (50, 100, 200, 400):
        yield back_end.back_end(landmarks, effort.frames)
    yield back_end.back_end(200, effort.frames, lag_s=back_end.TRACK_LAG_S)
    yield back_end.back_end(200, effort.frames // 3, factorisation=back_end.QR)
    for shared in (10, 50, 200):
        yield stages.fusion(shared, min(effort.repeats, 30))
    for shared in (10, 50, 200):
        yield stages.weight_search(shared, min(effort.repeats, 10))
    yield from stages.packets(64, PacketPolicy(), effort.repeats)
    yield from stages.packets(22, PacketPolicy(form=ANCHOR, descriptor_basis=COMPACT), effort.repeats)
    yield stages.preintegration(effort.repeats)
    yield bag_reading(vehicle, few, repeats=min(effort.repeats, 10))


def bag_reading(vehicle: SimulatedVehicle, frames: list[StereoFrame], *, repeats: int) -> Row:
    """Time reading a bag's raw images into stereo frames, beside reading the bytes of its file."""

    imu = [sample for sample in vehicle.imu.samples() if sample.stamp_ns <= frames[-1].stamp_ns]
    recording = FlightRecording(vehicle.name, vehicle.rig, imu, (), frames, vehicle.initial)
    with tempfile.TemporaryDirectory(prefix="uav_vslam_bench_") as folder:
        path = Path(folder) / "bag"
        write_flights(path, [recording])
        (file,) = path.glob("*.mcap")
        flight = open_flight(path, vehicle.name)
        ms, ratio = take_turns([lambda: list(flight.iter_events())] * repeats, file.read_bytes)
        megabytes = file.stat().st_size / 1e6
    width, height = flight.image_size
    return {
        "method": "bag reading",
        "condition": f"mcap, raw {width}x{height}",
        "ms_per_frame": ms / len(frames),
        "mb_per_s": megabytes / (ms * 1e-3),
        "ratio_to_reference": ratio,
        "reference": "reading its bytes",
    }


def _sift() -> Callable[[Any], object]:
    detector = cv2.SIFT_create()
    return lambda image: detector.detectAndCompute(image, None)
