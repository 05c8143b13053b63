# SPDX-License-Identifier: Apache-2.0
"""EuRoC's ASL folder layout as a flight recording; body is the IMU's frame, whose axes are not FLU on that sensor.

Layout: `mav0/{cam0,cam1,imu0,state_groundtruth_estimate0}/{data.csv,sensor.yaml}`, cam0 is left. Images are copied
byte for byte, lens distortion included. The world's z is up; gravity there is 9.81 m/s^2.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from uav_vslam.datasets.calibration_files import parse_calibration, yaml_tree
from uav_vslam.datasets.flight_writer import EncodedStereoFrame, FlightRecording
from uav_vslam.datasets.messages import TruthSample
from uav_vslam.errors import BagError, CalibrationError
from uav_vslam.geometry.camera import PinholeCamera
from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.rotation import rotation_from_quaternion_wxyz
from uav_vslam.geometry.stereo import StereoRig
from uav_vslam.types import ImuSample, NavEstimate, NavState

Array = NDArray[np.float64]

TRUTH_FOLDER = "state_groundtruth_estimate0"
MODEL = "radial-tangential"  # the distortion model of the sequences
FORMATS = {".jpg": "jpeg", ".jpeg": "jpeg", ".png": "png"}
TRUTH_GAP_NS = 50_000_000  # largest gap between truth rows across which the start state is interpolated


@dataclass(frozen=True, slots=True)
class InitialSigma:
    """Stated uncertainty of the start state, which is the ground truth."""

    position_m: float = 0.01
    velocity: float = 0.02  # [m/s]
    attitude_deg: float = 0.2
    gyro_bias: float = 1e-3  # [rad/s]
    accel_bias: float = 2e-2  # [m/s^2]

    def covariance(self) -> Array:
        """Return the (15, 15) covariance in the order of `NavEstimate`."""
        attitude = np.deg2rad(self.attitude_deg)
        sigma = [self.position_m, self.velocity, attitude, self.gyro_bias, self.accel_bias]
        return np.diag(np.repeat(sigma, 3) ** 2)


@dataclass(frozen=True, slots=True)
class _Table:
    """Rows of a data.csv: (N,) stamps [ns] and (N, C) numbers."""

    stamps_ns: NDArray[np.int64]
    values: Array

    def at(self, stamp_ns: int) -> Array:
        """Return the (C,) row at a stamp, linear between rows."""
        return np.array(
            [np.interp(stamp_ns - self.stamps_ns[0], self.stamps_ns - self.stamps_ns[0], c) for c in self.values.T]
        )


def read_euroc(mav0: Path, *, vehicle: str = "uav1", sigma: InitialSigma | None = None) -> FlightRecording:
    """Read a sequence; it starts at the first image pair with ground truth.

    Args:
        mav0: the folder that holds cam0, cam1, imu0 and the ground truth.
        vehicle: its ROS namespace.
        sigma: stated uncertainty of the start state.

    Raises:
        BagError: a file is missing or malformed, no images pair up, or none has ground truth.
        CalibrationError: the cameras' calibrations contradict each other.
    """
    left, T_body_left = _camera(mav0 / "cam0")
    right, T_body_right = _camera(mav0 / "cam1")
    imu, truth = _table(mav0 / "imu0", 6), _table(mav0 / TRUTH_FOLDER, 16)
    pairs = _pairs(mav0, truth)
    if not pairs:
        raise BagError(f"{mav0}: no pair of images with equal stamps is covered by ground truth; check data.csv")
    initial = NavEstimate(_state(truth, pairs[0][0], mav0), (sigma or InitialSigma()).covariance())
    return FlightRecording(
        vehicle=vehicle,
        rig=StereoRig(left, right, T_body_left, T_body_right),
        imu=_samples(imu),
        truth=_truth_samples(truth, imu),
        frames=_frames(pairs),
        initial=initial,
    )


def frame_count(mav0: Path) -> int:
    """Return the number of image pairs that `read_euroc` yields."""
    return len(_pairs(mav0, _table(mav0 / TRUTH_FOLDER, 16)))


def _samples(imu: _Table) -> Iterator[ImuSample]:
    for stamp, row in zip(imu.stamps_ns.tolist(), imu.values, strict=True):
        yield ImuSample(stamp, row[:3], row[3:])


def _truth_samples(truth: _Table, imu: _Table) -> Iterator[TruthSample]:
    for stamp, row in zip(truth.stamps_ns.tolist(), truth.values, strict=True):
        rate = imu.at(stamp)[:3] - row[10:13]
        yield TruthSample(stamp, Pose.from_quaternion_wxyz(row[3:7], row[:3]), row[7:10], rate)


def _frames(pairs: list[tuple[int, Path, Path]]) -> Iterator[EncodedStereoFrame]:
    for stamp, left, right in pairs:
        try:
            yield EncodedStereoFrame(stamp, left.read_bytes(), right.read_bytes(), FORMATS[left.suffix.lower()])
        except (OSError, KeyError) as error:
            raise BagError(f"the images at {stamp} ns can't be imported ({error}); use jpg or png") from None


def _state(truth: _Table, stamp_ns: int, mav0: Path) -> NavState:
    """Return the true state, interpolated between rows."""
    after = int(np.searchsorted(truth.stamps_ns, stamp_ns))
    before = max(after - 1, 0)
    if truth.stamps_ns[after] - truth.stamps_ns[before] > 2 * TRUTH_GAP_NS:
        raise BagError(f"{mav0}: ground truth has a gap at the first image ({stamp_ns} ns); cut the sequence later")
    row = truth.at(stamp_ns)
    R = rotation_from_quaternion_wxyz(row[3:7])
    return NavState(stamp_ns, Pose(R, row[:3]), row[7:10], row[10:13], row[13:16])


def _pairs(mav0: Path, truth: _Table) -> list[tuple[int, Path, Path]]:
    """Return (stamp, left file, right file) of all image pairs with equal stamps and ground truth."""
    left, right = _image_names(mav0 / "cam0"), _image_names(mav0 / "cam1")
    stamps = [at for at in sorted(left.keys() & right.keys()) if truth.stamps_ns[0] <= at <= truth.stamps_ns[-1]]
    return [(stamp, left[stamp], right[stamp]) for stamp in stamps]


def _image_names(camera: Path) -> dict[int, Path]:
    names = {}
    for line in _lines(camera / "data.csv"):
        stamp, _, name = line.partition(",")
        try:
            names[int(stamp)] = camera / "data" / name.strip()
        except ValueError:
            raise BagError(f"{camera / 'data.csv'}: {line!r} is not 'stamp,filename'") from None
    return names


def _camera(folder: Path) -> tuple[PinholeCamera, Pose]:
    """Return the intrinsics and T_body_cam of a sensor.yaml."""
    path = folder / "sensor.yaml"
    sensor = yaml_tree(_text(path), path)
    if sensor.get("distortion_model", MODEL) != MODEL:
        raise CalibrationError(f"{folder}: distortion model {sensor['distortion_model']!r}; use {MODEL}")
    calibration = parse_calibration(sensor, path)
    T_body_cam = calibration.T_body_cam(0)
    if T_body_cam is None:
        raise CalibrationError(f"{path}: no camera with T_BS; is it an ASL folder (mav0)?")
    return calibration.cameras[0].camera, T_body_cam


def _table(folder: Path, columns: int) -> _Table:
    path = folder / "data.csv"
    rows = [line.split(",") for line in _lines(path)]
    try:
        stamps = np.array([int(row[0]) for row in rows], dtype=np.int64)
        values = np.array([row[1 : 1 + columns] for row in rows], dtype=float).reshape(-1, columns)
    except ValueError as error:
        raise BagError(f"{path}: rows must hold a stamp and {columns} numbers ({error})") from None
    if not len(stamps) or np.any(np.diff(stamps) <= 0):
        raise BagError(f"{path}: {len(stamps)} rows whose stamps must increase; sort or fill the file")
    return _Table(stamps, values)


def _lines(path: Path) -> list[str]:
    return [line for line in _text(path).splitlines() if line.strip() and not line.startswith("#")]


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except OSError as error:
        raise BagError(f"{path}: can't be read ({error.strerror}); is it an ASL folder (mav0)?") from None
