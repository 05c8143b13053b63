# SPDX-License-Identifier: Apache-2.0
"""The ways in which one flight is recorded, and the settings with which each recording is flown."""

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import zstandard

from uav_vslam.config import InputConfig
from uav_vslam.datasets.cdr import RawMessage, decode, encode
from uav_vslam.datasets.flight_writer import FlightRecording, ImageCoding, write_flights
from uav_vslam.datasets.message_builders import image_message
from uav_vslam.datasets.messages import image_of, stamp_ns_of
from uav_vslam.geometry.camera import PinholeCamera
from uav_vslam.geometry.pose import Pose
from uav_vslam.simulation.imu import ideal_imu
from uav_vslam.simulation.recording import recording_of
from uav_vslam.simulation.scenario import SimulatedVehicle
from uav_vslam.simulation.terrain import Ground
from uav_vslam.studies.recordings.foreign import (
    FOREIGN_TOPICS,
    UPSIDE_DOWN,
    Change,
    edited,
    in_imu_frame,
    renamed,
    rewritten,
    shifted,
    with_imu_edge,
    without,
    write_kalibr,
)
from uav_vslam.studies.recordings.ros1 import write_ros1
from uav_vslam.types import NS_PER_S, ImuSample

IMAGES = ("/uav1/left/image_raw", "/uav1/right/image_raw")
INFOS = ("/uav1/left/camera_info", "/uav1/right/camera_info")
OFFSET_NS = 3_000_000
LEVER_ARM_BODY_M = (0.2, -0.1, 0.2)  # 0.3 m
T_BODY_IMU = Pose(UPSIDE_DOWN.R, np.array(LEVER_ARM_BODY_M))
FISHEYE = np.array([0.05, -0.02, 0.01, -0.003])  # k1 to k4 of an equidistant lens
RATE_STEP_S = 1e-4  # of the difference that gives the angular acceleration


@dataclass(frozen=True, slots=True)
class Plain:
    """A flight and its conventional recording."""

    vehicle: SimulatedVehicle
    ground: Ground
    bag: Path


@dataclass(frozen=True, slots=True)
class Made:
    """A recording, and the input settings that it needs."""

    bag: Path
    config: InputConfig = field(default_factory=InputConfig)


Way = Callable[[Plain, Path], Made]  # records into a new folder, which exists


def _rewriting(*changes: Change, config: InputConfig | None = None, storage: str = "mcap") -> Way:
    return lambda plain, folder: Made(
        rewritten(plain.bag, folder / "bag", *changes, storage=storage), config or InputConfig()
    )


def _encoded(encoding: str, convert: Callable[[Any], Any]) -> Way:
    """Return a way with other pixels in the image messages."""

    def change(raw: RawMessage) -> RawMessage:
        if raw.topic not in IMAGES:
            return raw
        built = decode(raw)
        pixels = convert(image_of(built))
        again = image_message(stamp_ns_of(built), built.header.frame_id, pixels, encoding=encoding)
        return dataclasses.replace(raw, data=encode(again))

    return _rewriting(change)


def _compressed(plain: Plain, folder: Path) -> Made:
    """Compress the images, and then the file."""
    write_flights(folder / "bag", [recording_of(plain.vehicle, plain.ground)], coding=ImageCoding("png"))
    (file,) = (folder / "bag").glob("*.mcap")
    packed = folder / f"{file.name}.zstd"
    packed.write_bytes(zstandard.compress(file.read_bytes()))
    return Made(packed)


def _elsewhere(plain: Plain, folder: Path) -> Made:
    """Record an IMU at 400 Hz that is turned by half a turn and away from the body's origin, in a frame of its own."""
    recording = dataclasses.replace(
        recording_of(plain.vehicle, plain.ground), imu=twice_as_fast(plain.vehicle, T_BODY_IMU)
    )
    write_flights(folder / "body", [recording])
    with_edge = partial(with_imu_edge, T_body_imu=T_BODY_IMU)
    changes = [edited("/uav1/imu/data_raw", in_imu_frame), edited("/tf_static", with_edge)]
    return Made(rewritten(folder / "body", folder / "bag", *changes))


def twice_as_fast(vehicle: SimulatedVehicle, T_body_imu: Pose) -> list[ImuSample]:
    """Return what an IMU elsewhere in the body reads at twice the rate, with errors that average to the plain ones.

    A plain reading's white noise m becomes m + d and m - d, with d drawn as the density asks at the new rate.
    """
    plain, truth, config = vehicle.imu, vehicle.truth, vehicle.scenario.imu_config
    half_ns = int(np.median(np.diff(plain.stamps_ns))) // 2
    stamps = np.stack([plain.stamps_ns, plain.stamps_ns + half_ns], axis=1).ravel()
    ideal = ideal_imu(truth, stamps, gravity=config.gravity)
    t = truth.time_s(stamps)
    rates = [truth.angular_rate_body(t + dt_s) for dt_s in (-RATE_STEP_S, RATE_STEP_S)]
    acceleration = (rates[1] - rates[0]) / (2.0 * RATE_STEP_S)
    w, arm = ideal.gyro, T_body_imu.t
    force = ideal.accel + np.cross(acceleration, arm) + np.cross(w, np.cross(w, arm))
    reference = ideal_imu(truth, plain.stamps_ns, gravity=config.gravity)
    rng = np.random.default_rng(np.random.SeedSequence([vehicle.scenario.seed, vehicle.index]))
    gyro = w + _doubled(plain.gyro - reference.gyro, config.gyro_noise, half_ns, rng)
    accel = force + _doubled(plain.accel - reference.accel, config.accel_noise, half_ns, rng)
    R_imu_body = T_body_imu.R.T
    return [ImuSample(int(s), R_imu_body @ g, R_imu_body @ a) for s, g, a in zip(stamps, gyro, accel, strict=True)]


def _doubled(errors: Any, density: float, half_ns: int, rng: np.random.Generator) -> Any:
    apart = rng.normal(0.0, density * np.sqrt(0.5 * NS_PER_S / half_ns), errors.shape)
    return np.stack([errors + apart, errors - apart], axis=1).reshape(-1, 3)


def _fisheye(plain: Plain, folder: Path) -> Made:
    """Record through equidistant lenses, with the calibration in a file of Kalibr alone."""
    rig = dataclasses.replace(
        plain.vehicle.rig, left=_equidistant(plain.vehicle.rig.left), right=_equidistant(plain.vehicle.rig.right)
    )
    recording: FlightRecording = recording_of(dataclasses.replace(plain.vehicle, rig=rig), plain.ground)
    write_flights(folder / "whole", [recording])
    bag = rewritten(folder / "whole", folder / "bag", without("/tf_static", *INFOS))
    return Made(bag, InputConfig(calibration=(write_kalibr(rig, folder),)))


def _equidistant(camera: PinholeCamera) -> PinholeCamera:
    return dataclasses.replace(camera, distortion=FISHEYE, model="equidistant")


PLAIN = "plain"
WAYS: dict[str, Way] = {
    PLAIN: lambda plain, folder: Made(plain.bag),
    "other topics": _rewriting(renamed, config=InputConfig(topics=FOREIGN_TOPICS)),
    "sqlite3": _rewriting(storage="sqlite3"),
    "ROS 1": lambda plain, folder: Made(write_ros1(plain.bag, folder / "flight.bag")),
    "compressed": _compressed,
    "rgb8": _encoded("rgb8", lambda image: np.repeat(image[..., None], 3, axis=2)),
    "mono16": _encoded("mono16", lambda image: image.astype(np.uint16) << 8),
    "16UC1, 12 bits": _encoded("16UC1", lambda image: image.astype(np.uint16) << 4),
    "right stamps 3 ms late": _rewriting(edited(IMAGES[1], lambda image: shifted(image, OFFSET_NS))),
    "IMU at 400 Hz, turned, 0.3 m off": _elsewhere,
    "equidistant, Kalibr file": _fisheye,
}
