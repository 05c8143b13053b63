# SPDX-License-Identifier: Apache-2.0
"""Reading a bag and importing a data set, beside reading all messages of the same bag with `rosbags` alone.

Our reader adds the pairing of images, their order by stamp, and arrays of pixels; an import reads the files of the
pictures and the tables, and writes the bag.
"""

import shutil
import tempfile
from collections import deque
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import yaml
from rosbags.rosbag2 import Reader

from uav_vslam.datasets.bag import open_flight
from uav_vslam.datasets.cdr import typestore
from uav_vslam.datasets.flight_writer import FlightRecording, ImageCoding, write_flights
from uav_vslam.datasets.importing.euroc import TRUTH_FOLDER, read_euroc
from uav_vslam.datasets.importing.source import write_source
from uav_vslam.evaluation.study import Row
from uav_vslam.simulation.scenario import SimulatedVehicle
from uav_vslam.studies.bench.stages import Work, row, take_turns
from uav_vslam.types import StereoFrame


def recordings(vehicle: SimulatedVehicle, frames: list[StereoFrame], *, repeats: int) -> Iterator[Row]:
    """Time reading a flight's bag, with raw and with compressed images, and importing it from EuRoC's layout."""
    with tempfile.TemporaryDirectory(prefix="uav_vslam_bench_") as folder:
        for coding in ("raw", "png"):
            yield _reading(vehicle, frames, coding, Path(folder) / coding, repeats)
        yield _importing(vehicle, frames, Path(folder), repeats)


def _reading(vehicle: SimulatedVehicle, frames: list[StereoFrame], coding: str, path: Path, repeats: int) -> Row:
    """Time reading a bag into stereo frames and readings; the images of the reference are decoded as well."""
    imu = [sample for sample in vehicle.imu.samples() if sample.stamp_ns <= frames[-1].stamp_ns]
    recording = FlightRecording(vehicle.name, vehicle.rig, imu, (), frames, vehicle.initial)
    write_flights(path, [recording], coding=ImageCoding(coding))
    flight = open_flight(path, vehicle.name)
    works = [lambda: deque(flight.iter_events(), maxlen=0)] * repeats
    measured = take_turns(works, lambda: _read_by_rosbags(path))
    reference = "rosbags' reader" if coding == "raw" else "rosbags' reader and imdecode"
    return _row("bag reading", f"mcap, {coding}", path, len(frames), measured, reference)


def _importing(vehicle: SimulatedVehicle, frames: list[StereoFrame], folder: Path, repeats: int) -> Row:
    """Time an import from png files and tables; the reference reads the bag that it makes, without decoding images."""
    mav0, bag = _write_euroc(vehicle, frames, folder / "mav0"), folder / "imported"
    _import(mav0, bag)

    def works() -> Iterator[Work]:
        """Yield imports; what each has made is removed outside of its time."""
        for number in range(repeats):
            out = folder / f"imported{number}"
            yield partial(_import, mav0, out)
            shutil.rmtree(out)

    measured = take_turns(works(), lambda: _read_by_rosbags(bag, decode=False))
    return _row("import", "png files, EuRoC's layout", bag, len(frames), measured, "rosbags' reader, its bag")


def _import(mav0: Path, out: Path) -> None:
    write_source(read_euroc(mav0), out)


def _row(method: str, condition: str, bag: Path, frames: int, measured: tuple[float, float], reference: str) -> Row:
    ms, ratio = measured
    (file,) = bag.glob("*.mcap")
    mb_per_s = file.stat().st_size / 1e3 / ms
    return row(method, condition, reference, ratio, ms_per_frame=ms / frames, mb_per_s=mb_per_s)


def _read_by_rosbags(bag: Path, *, decode: bool = True) -> None:
    """Read and deserialise every message, and decode compressed images if wanted."""
    store = typestore()
    with Reader(bag) as reader:
        for connection, _, data in reader.messages():
            built: Any = store.deserialize_cdr(data, connection.msgtype)
            if decode and hasattr(built, "format"):
                cv2.imdecode(built.data, cv2.IMREAD_ANYDEPTH | cv2.IMREAD_ANYCOLOR)


def _write_euroc(vehicle: SimulatedVehicle, frames: list[StereoFrame], mav0: Path) -> Path:
    """Write a flight in EuRoC's layout."""
    rig = vehicle.rig
    sides = (("cam0", rig.left, rig.T_body_left, "left"), ("cam1", rig.right, rig.T_body_right, "right"))
    for name, camera, T_body_cam, side in sides:
        (mav0 / name / "data").mkdir(parents=True)
        for frame in frames:
            cv2.imwrite(str(mav0 / name / "data" / f"{frame.stamp_ns}.png"), getattr(frame, side))
        sensor = {
            "T_BS": {"data": T_body_cam.matrix.ravel().tolist()},
            "resolution": [camera.width, camera.height],
            "intrinsics": [camera.fx, camera.fy, camera.cx, camera.cy],
            "distortion_coefficients": [],
        }
        (mav0 / name / "sensor.yaml").write_text(yaml.safe_dump(sensor), encoding="utf-8")
        _write_rows(mav0 / name, [(frame.stamp_ns, f"{frame.stamp_ns}.png") for frame in frames])
    readings = [s for s in vehicle.imu.samples() if s.stamp_ns <= frames[-1].stamp_ns]
    _write_rows(mav0 / "imu0", [(s.stamp_ns, *s.gyro.tolist(), *s.accel.tolist()) for s in readings])
    states = [vehicle.true_state(frame.stamp_ns) for frame in frames]
    rows = [(*s.T_map_body.t, *s.T_map_body.quaternion_wxyz, *s.v_map, *s.gyro_bias, *s.accel_bias) for s in states]
    _write_rows(mav0 / TRUTH_FOLDER, [(s.stamp_ns, *map(float, row)) for s, row in zip(states, rows, strict=True)])
    return mav0


def _write_rows(folder: Path, rows: list[tuple[object, ...]]) -> None:
    folder.mkdir(exist_ok=True)
    text = "".join(",".join(map(str, row)) + "\n" for row in rows)
    (folder / "data.csv").write_text(text, encoding="utf-8")
