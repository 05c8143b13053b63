# SPDX-License-Identifier: Apache-2.0
"""Calibration files of other tools: Kalibr, ROS camera_info and EuRoC, each recognised by its content.

    Kalibr   camchain.yaml, camchain-imucam.yaml, imu.yaml     both cameras, their place at the IMU, noise, clock offset
    ROS      one file per camera (camera_calibration_parsers)  intrinsics; the rig of a rectified pair
    EuRoC    cam0, cam1 and imu0 of a `mav0` folder            intrinsics, `T_BS`, noise

Cameras count in the order of the files: the first is the left one. The body is Kalibr's IMU, or EuRoC's body (`T_BS`).
"""

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from uav_vslam.datasets.kalibr_camchain import KALIBR_LENSES
from uav_vslam.datasets.stereo_sync import NOTABLE_OFFSET_NS
from uav_vslam.errors import CalibrationError, one_line
from uav_vslam.geometry.camera import COEFFICIENTS, PinholeCamera
from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.stereo import MIN_BASELINE_M
from uav_vslam.types import NS_PER_S

Array = NDArray[np.float64]
Tree = Mapping[str, Any]

# What other tools call the models of `PinholeCamera`; none of the other names is one.
LENS_MODELS = {
    "": "plumb_bob",
    "none": "plumb_bob",
    "radial-tangential": "plumb_bob",
    "fisheye": "equidistant",
    **KALIBR_LENSES,
}
NOISE = {  # of Kalibr and EuRoC: settings of ours
    "gyroscope_noise_density": "imu.gyro_noise",
    "accelerometer_noise_density": "imu.accel_noise",
    "gyroscope_random_walk": "imu.gyro_bias_walk",
    "accelerometer_random_walk": "imu.accel_bias_walk",
}
ORTHOGONAL = 5e-3  # largest deviation of R R^T from the identity: three decimals
EUROC_SENSORS = ("cam0/sensor.yaml", "cam1/sensor.yaml", "imu0/sensor.yaml")


@dataclass(frozen=True, slots=True)
class CameraCalibration:
    """One camera of a calibration.

    Attributes:
        camera: intrinsics.
        T_body_cam: pose of the optical frame, None if the file has none.
        T_left_cam: pose in the left camera's frame, None likewise.
        time_offset_s: IMU time minus image stamp [s].
    """

    camera: PinholeCamera
    T_body_cam: Pose | None = None
    T_left_cam: Pose | None = None
    time_offset_s: float = 0.0


@dataclass(frozen=True, slots=True)
class Calibration:
    """What calibration files hold; the rest comes from the recording or its topics.

    Attributes:
        cameras: left and right one; fewer where the files have none.
        noise: settings of the IMU by name ("imu.gyro_noise"), with the values of the files.
        T_body_imu: pose of the IMU, None if the files have none.
    """

    cameras: tuple[CameraCalibration, ...] = ()
    noise: Mapping[str, float] = field(default_factory=dict)
    T_body_imu: Pose | None = None

    @property
    def time_offset_s(self) -> float:
        """IMU time minus image stamp [s]."""
        return self.cameras[0].time_offset_s if self.cameras else 0.0

    @property
    def unequal_clocks(self) -> str:
        """Why images with equal stamps were not exposed together, by the files; empty if they were."""
        apart_s = self.cameras[1].time_offset_s - self.time_offset_s if len(self.cameras) > 1 else 0.0
        if abs(apart_s) * NS_PER_S <= NOTABLE_OFFSET_NS:
            return ""
        return (
            f"by timeshift_cam_imu the right camera is exposed {1e3 * apart_s:+.1f} ms from the left one in images of "
            "equal stamps, and only the left one's counts: trigger the cameras together, or mend the stamps"
        )

    def T_body_cam(self, index: int) -> Pose | None:
        """Return the pose of a camera in the body, 0 for the left one; None if the files have none."""
        if index >= len(self.cameras):
            return None
        known, left = self.cameras[index], self.cameras[0]
        if known.T_body_cam is not None or left.T_body_cam is None or known.T_left_cam is None:
            return known.T_body_cam
        return left.T_body_cam @ known.T_left_cam


def read_calibration(paths: Sequence[Path]) -> Calibration:
    """Read calibration files that together describe one vehicle.

    Args:
        paths: files; a `mav0` folder stands for the sensor.yaml in its cam0, cam1 and imu0.

    Raises:
        CalibrationError: a file can't be read, is none of the known kinds, or there are more than two cameras.
    """
    cameras: list[CameraCalibration] = []
    noise: dict[str, float] = {}
    T_body_imu: Pose | None = None
    for path in [file for given in paths for file in _files(given)]:
        found = parse_calibration(yaml_tree(_text(path), path), path)
        cameras += found.cameras
        noise |= found.noise
        T_body_imu = found.T_body_imu or T_body_imu
    if len(cameras) > 2:
        names = ", ".join(map(str, paths))
        raise CalibrationError(f"{names}: {len(cameras)} cameras; give the files of the left and the right one")
    return Calibration(tuple(_related(cameras)), noise, T_body_imu)


def yaml_tree(text: str, path: Path) -> dict[str, Any]:
    """Return the content of a YAML file, also with OpenCV's header.

    Args:
        text: of the file.
        path: named in errors.

    Raises:
        CalibrationError: it holds no keys and values.
    """
    lines = text.splitlines()
    if lines and lines[0].startswith("%YAML"):  # OpenCV's "%YAML:1.0" is not valid YAML
        lines = lines[1:]
    try:
        tree = yaml.safe_load("\n".join(lines))
    except (yaml.YAMLError, ValueError) as error:
        raise CalibrationError(f"{path}: not valid YAML ({one_line(error)})") from None
    if not isinstance(tree, dict):
        raise CalibrationError(f"{path}: holds no keys and values; give a calibration of Kalibr, ROS or EuRoC")
    return tree


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8-sig")  # editors may write a byte order mark
    except OSError as error:
        raise CalibrationError(f"{path}: can't be read ({error.strerror})") from None
    except ValueError as error:
        raise CalibrationError(f"{path}: not valid YAML ({error})") from None


def camera(size: Sequence[Any], intrinsics: Sequence[Any], model: str, coefficients: Sequence[Any]) -> PinholeCamera:
    """Return a camera from the numbers of a file.

    Args:
        size: width and height [px].
        intrinsics: fx, fy, cx, cy [px].
        model: distortion model as any of the tools calls it.
        coefficients: of the lens; trailing zeros may be missing.

    Raises:
        CalibrationError: the model is not supported or a number is missing.
    """
    model = LENS_MODELS.get(model, model)
    distortion = [float(value) for value in coefficients]
    if model in COEFFICIENTS and model != "equidistant":
        distortion += [0.0] * (COEFFICIENTS[model] - len(distortion))
    width, height = map(int, size)
    fx, fy, cx, cy = map(float, intrinsics)
    return PinholeCamera(width, height, fx, fy, cx, cy, np.array(distortion), model)


def _files(path: Path) -> list[Path]:
    if not path.is_dir():
        return [path]
    files = [path / name for name in EUROC_SENSORS if (path / name).is_file()]
    if not files:
        raise CalibrationError(f"{path}: a folder without {', '.join(EUROC_SENSORS)}; give the calibration files")
    return files


def parse_calibration(tree: Tree, path: Path) -> Calibration:
    """Return the content of one file.

    Args:
        tree: content of the file.
        path: named in errors.

    Raises:
        CalibrationError: it is none of the known kinds, or malformed.
    """
    kinds: dict[str, Callable[[Tree], Calibration]] = {
        "cam0": _of_kalibr,
        "imu0": lambda file: Calibration(noise=_noise(file["imu0"])),
        "camera_matrix": _of_ros,
        "intrinsics": _of_euroc,
        "gyroscope_noise_density": _of_euroc_imu,
    }
    for key, parse in kinds.items():
        if key in tree:
            try:
                return parse(tree)
            except CalibrationError as error:
                raise CalibrationError(f"{path}: {error}") from None
            except KeyError as error:
                raise CalibrationError(f"{path}: {error.args[0]} is missing") from None
            except (AttributeError, OverflowError, TypeError, ValueError) as error:
                raise CalibrationError(f"{path}: malformed ({error})") from None
    raise CalibrationError(f"{path}: no calibration of Kalibr, ROS or EuRoC; it needs one of {', '.join(kinds)}")


def _of_kalibr(tree: Tree) -> Calibration:
    cameras: list[CameraCalibration] = []
    T_left_previous = Pose.identity()
    for name in sorted(key for key in tree if key.startswith("cam")):
        one = tree[name]
        if one["camera_model"] != "pinhole":
            raise CalibrationError(f"{name}: camera_model {one['camera_model']!r} is not supported; use pinhole")
        T_left_cam = None
        if not cameras:
            T_left_cam = Pose.identity()
        elif "T_cn_cnm1" in one:  # maps the previous camera's coordinates to this one's
            T_left_previous = T_left_previous @ rigid_pose(one["T_cn_cnm1"], f"{name}: T_cn_cnm1").inverse()
            T_left_cam = T_left_previous
        cameras.append(
            CameraCalibration(
                camera(one["resolution"], one["intrinsics"], one["distortion_model"], one["distortion_coeffs"]),
                rigid_pose(one["T_cam_imu"], f"{name}: T_cam_imu").inverse() if "T_cam_imu" in one else None,
                T_left_cam,
                _offset_s(one.get("timeshift_cam_imu", cameras[0].time_offset_s if cameras else 0.0)),
            )
        )
    return Calibration(tuple(cameras))


def _of_ros(tree: Tree) -> Calibration:
    """Return one camera; the projection matrix says where the right one of a rectified pair is."""
    K = _matrix(tree["camera_matrix"], 3, 3)
    size = tree["image_width"], tree["image_height"]
    coefficients = tree.get("distortion_coefficients", {}).get("data", [])
    found = camera(size, [K[0, 0], K[1, 1], K[0, 2], K[1, 2]], tree.get("distortion_model", ""), coefficients)
    T_pair_cam = None
    if "projection_matrix" in tree and "rectification_matrix" in tree:
        P = _matrix(tree["projection_matrix"], 3, 4)
        R_pair_cam = _matrix(tree["rectification_matrix"], 3, 3)
        if P[0, 0] > 0 and P[1, 1] > 0:  # P = K' [I | t], t from the left camera to this one
            T_pair_cam = Pose(R_pair_cam, -np.array([P[0, 3] / P[0, 0], P[1, 3] / P[1, 1], 0.0]))
    return Calibration((CameraCalibration(found, T_left_cam=T_pair_cam),))


def _of_euroc(tree: Tree) -> Calibration:
    model = tree.get("distortion_model", "radial-tangential")
    found = camera(tree["resolution"], tree["intrinsics"], model, tree["distortion_coefficients"])
    return Calibration((CameraCalibration(found, rigid_pose(tree["T_BS"]["data"], "T_BS")),))


def _of_euroc_imu(tree: Tree) -> Calibration:
    """Return the content of an IMU's sensor.yaml; Kalibr's imu.yaml has the same keys, but for the pose."""
    T_body_imu = rigid_pose(tree["T_BS"]["data"], "T_BS") if "T_BS" in tree else None
    return Calibration(noise=_noise(tree), T_body_imu=T_body_imu)


def _related(cameras: Sequence[CameraCalibration]) -> list[CameraCalibration]:
    """Return the cameras with their pose in the left one, where both have one in a common frame."""
    if len(cameras) < 2:
        return list(cameras)
    left, right = cameras
    if left.T_left_cam is None or right.T_left_cam is None:
        return [left, right]
    T_left_right = left.T_left_cam.inverse() @ right.T_left_cam
    if np.linalg.norm(T_left_right.t) < MIN_BASELINE_M:  # each was calibrated alone, and says nothing of the other
        return [dataclasses.replace(camera, T_left_cam=None) for camera in cameras]
    return [
        CameraCalibration(left.camera, left.T_body_cam, Pose.identity(), left.time_offset_s),
        CameraCalibration(right.camera, right.T_body_cam, T_left_right, right.time_offset_s),
    ]


def _noise(tree: Tree) -> dict[str, float]:
    return {setting: float(tree[name]) for name, setting in NOISE.items() if name in tree}


def rigid_pose(values: Any, name: str) -> Pose:
    """Return the pose of a 4x4 matrix, or of the 12 numbers of its upper rows.

    Args:
        values: of the matrix, by rows.
        name: of the matrix, for errors.

    Raises:
        CalibrationError: it is no rotation and translation: transposed, with a typing error, or not filled in.
        ValueError: it has another number of columns.
    """
    rows = np.array(values, dtype=float).reshape(-1, 4)
    R, t = np.split(rows[:3], [3], axis=1)
    if not (len(rows) in (3, 4) and is_rotation(R) and np.isfinite(t).all() and (rows[3:] == [0, 0, 0, 1]).all()):
        raise CalibrationError(
            f"{name} is no rotation and translation: {rows.tolist()}; give it by rows, of which a fourth is 0 0 0 1"
        )
    return Pose(R.copy(), t.ravel())


def is_rotation(R: Array) -> bool:
    """Return whether a (3, 3) matrix is a rotation, but for the rounding of a text file."""
    return bool(np.abs(R @ R.T - np.eye(3)).max() <= ORTHOGONAL and np.linalg.det(R) > 0)


def _offset_s(value: Any) -> float:
    offset_s = float(value)
    if not math.isfinite(offset_s):
        raise ValueError(f"timeshift_cam_imu is {value}")
    return offset_s


def _matrix(entry: Tree, rows: int, columns: int) -> Array:
    return np.array(entry["data"], dtype=float).reshape(rows, columns)
