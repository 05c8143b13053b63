# SPDX-License-Identifier: Apache-2.0
"""Calibration files of other tools, each recognised by its content.

    Kalibr        camchain.yaml, camchain-imucam.yaml, imu.yaml     both cameras, their place at the IMU, noise, clock
                                                                    offset; OpenVINS has the same with `T_imu_cam`
    ORB-SLAM3,    settings, `opencv_calibrations`                   the same; VINS-Fusion's noise is left alone
    VINS-Fusion
    ROS           one file per camera (camera_calibration_parsers)  intrinsics; the rig of a rectified pair
    EuRoC         cam0, cam1 and imu0 of a `mav0` folder            intrinsics, `T_BS`, noise

Cameras count in the order of the files: the first is the left one. The body is EuRoC's (`T_BS`), otherwise the IMU.
"""

import dataclasses
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from uav_vslam.datasets.calibration_tree import Tree, read_tree
from uav_vslam.datasets.camera_calibration import (
    Calibration,
    CameraCalibration,
    camera,
    finite,
    pose_in_pair,
    rigid_pose,
)
from uav_vslam.datasets.opencv_calibrations import of_orb_slam, of_vins
from uav_vslam.errors import CalibrationError
from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.stereo import MIN_BASELINE_M

Array = NDArray[np.float64]

NOISE = {  # of Kalibr and EuRoC: settings of ours
    "gyroscope_noise_density": "imu.gyro_noise",
    "accelerometer_noise_density": "imu.accel_noise",
    "gyroscope_random_walk": "imu.gyro_bias_walk",
    "accelerometer_random_walk": "imu.accel_bias_walk",
}
KINDS = "Kalibr, OpenVINS, ORB-SLAM3, VINS-Fusion, ROS or EuRoC"
EUROC_SENSORS = ("cam0/sensor.yaml", "cam1/sensor.yaml", "imu0/sensor.yaml")


def read_calibration(paths: Sequence[Path], names: Sequence[str] = ()) -> Calibration:
    """Read calibration files that together describe one vehicle.

    Args:
        paths: files; a `mav0` folder stands for the sensor.yaml in its cam0, cam1 and imu0.
        names: of the left and the right camera, where a file names more; empty if there are no more than two.

    Raises:
        CalibrationError: a file can't be read, is none of the known kinds, or does not have the cameras.
    """
    cameras: list[CameraCalibration] = []
    noise: dict[str, float] = {}
    T_body_imu: Pose | None = None
    for path in [file for given in paths for file in _files(given)]:
        found = parse_calibration(read_tree(path), path)
        cameras += found.cameras
        noise |= found.noise
        T_body_imu = found.T_body_imu or T_body_imu
    return Calibration(tuple(_related(_chosen(cameras, names, paths))), noise, T_body_imu)


def _chosen(
    cameras: Sequence[CameraCalibration], names: Sequence[str], paths: Sequence[Path]
) -> Sequence[CameraCalibration]:
    """Return the cameras of the names, or those that are there if there are no more than two."""
    if not names and len(cameras) <= 2:
        return cameras
    by_name = {one.name: one for one in cameras if one.name}
    if len(set(names)) == 2 and set(names) <= by_name.keys():
        return [by_name[name] for name in names]
    there, files = ", ".join(by_name), ", ".join(map(str, paths))
    if names:
        given = f"input.cameras [{', '.join(names)}] are not two of the names in {files}"
        raise CalibrationError(f"{given}: {there or 'it names none; leave input.cameras empty'}")
    remedy = f"name the left and the right one of {there} by input.cameras" if there else "give the files of the pair"
    raise CalibrationError(f"{files}: {len(cameras)} cameras; {remedy}")


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
        "Camera1.fx": of_orb_slam,
        "cam0_calib": lambda file: of_vins(file, path),
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
    raise CalibrationError(f"{path}: no calibration of {KINDS}; it needs one of {', '.join(kinds)}")


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
        elif "T_cn_cnm1" in one and name != f"cam{len(cameras)}":
            if "T_cam_imu" not in one:
                remedy = "keep all cameras in the file, and name two by input.cameras"
                raise CalibrationError(f"{name}: the camera before, to which T_cn_cnm1 refers, is missing; {remedy}")
        elif "T_cn_cnm1" in one:  # maps the previous camera's coordinates to this one's
            T_left_previous = T_left_previous @ rigid_pose(one["T_cn_cnm1"], f"{name}: T_cn_cnm1").inverse()
            T_left_cam = T_left_previous
        cameras.append(
            CameraCalibration(
                camera(one["resolution"], one["intrinsics"], one["distortion_model"], one["distortion_coeffs"]),
                _pose_at_imu(one, name),
                T_left_cam,
                finite(one.get("timeshift_cam_imu", cameras[0].time_offset_s if cameras else 0.0), "timeshift_cam_imu"),
                name,
            )
        )
    return Calibration(tuple(cameras))


def _pose_at_imu(one: Tree, name: str) -> Pose | None:
    """Return the pose of Kalibr's or OpenVINS's camera at the IMU; None for one of a chain without an IMU."""
    if "T_imu_cam" in one:
        return rigid_pose(one["T_imu_cam"], f"{name}: T_imu_cam")
    return rigid_pose(one["T_cam_imu"], f"{name}: T_cam_imu").inverse() if "T_cam_imu" in one else None


def _of_ros(tree: Tree) -> Calibration:
    """Return one camera; the projection matrix says where the right one of a rectified pair is."""
    K = _matrix(tree["camera_matrix"], 3, 3)
    size = tree["image_width"], tree["image_height"]
    coefficients = tree.get("distortion_coefficients", {}).get("data", [])
    found = camera(size, [K[0, 0], K[1, 1], K[0, 2], K[1, 2]], tree.get("distortion_model", ""), coefficients)
    T_pair_cam = None
    if "projection_matrix" in tree and "rectification_matrix" in tree:
        P, R = _matrix(tree["projection_matrix"], 3, 4), _matrix(tree["rectification_matrix"], 3, 3)
        T_pair_cam = pose_in_pair(P, R)
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
    poses: tuple[Pose | None, ...] = Pose.identity(), T_left_right
    if np.linalg.norm(T_left_right.t) < MIN_BASELINE_M:  # each was calibrated alone, and says nothing of the other
        poses = None, None
    return [dataclasses.replace(camera, T_left_cam=pose) for camera, pose in zip(cameras, poses, strict=True)]


def _noise(tree: Tree) -> dict[str, float]:
    return {setting: float(tree[name]) for name, setting in NOISE.items() if name in tree}


def _matrix(entry: Tree, rows: int, columns: int) -> Array:
    return np.array(entry["data"], dtype=float).reshape(rows, columns)
