# SPDX-License-Identifier: Apache-2.0
"""Calibrations in the settings of ORB-SLAM3 and VINS-Fusion, which OpenCV reads there.

Poses of cameras are in the IMU's frame in both. ORB-SLAM3's noise is a density as Kalibr's; that of VINS-Fusion is of
single readings and usually inflated, and is left alone.
"""

from pathlib import Path
from typing import Any

import numpy as np

from uav_vslam.datasets.calibration_tree import Tree, read_tree
from uav_vslam.datasets.camera_calibration import Calibration, CameraCalibration, camera, finite, rigid_pose
from uav_vslam.errors import CalibrationError
from uav_vslam.geometry.camera import PinholeCamera
from uav_vslam.geometry.pose import Pose

ORB_SLAM_LENSES = {  # by `Camera.type`: our model, and the names of its coefficients
    "PinHole": ("plumb_bob", ("k1", "k2", "p1", "p2", "k3")),
    "KannalaBrandt8": ("equidistant", ("k1", "k2", "k3", "k4")),
    "Rectified": ("plumb_bob", ()),
}
ORB_SLAM_NOISE = {
    "IMU.NoiseGyro": "imu.gyro_noise",
    "IMU.NoiseAcc": "imu.accel_noise",
    "IMU.GyroWalk": "imu.gyro_bias_walk",
    "IMU.AccWalk": "imu.accel_bias_walk",
}


def of_orb_slam(tree: Tree) -> Calibration:
    """Return the content of ORB-SLAM3's settings, file version 1.0: one camera, or both."""
    kind = tree["Camera.type"]
    if kind not in ORB_SLAM_LENSES:
        raise CalibrationError(f"Camera.type {kind!r} is not supported; use {', '.join(ORB_SLAM_LENSES)}")
    T_body_left = rigid_pose(tree["IMU.T_b_c1"]["data"], "IMU.T_b_c1") if "IMU.T_b_c1" in tree else None
    cameras = [CameraCalibration(_orb_slam_camera(tree, "Camera1"), T_body_left, Pose.identity())]
    if kind == "Rectified" and "Stereo.b" in tree:
        T_left_right = Pose(np.eye(3), np.array([float(tree["Stereo.b"]), 0.0, 0.0]))
        cameras.append(CameraCalibration(cameras[0].camera, None, T_left_right))
    elif "Camera2.fx" in tree:
        T_left_right = rigid_pose(tree["Stereo.T_c1_c2"]["data"], "Stereo.T_c1_c2")
        cameras.append(CameraCalibration(_orb_slam_camera(tree, "Camera2"), None, T_left_right))
    noise = {setting: float(tree[name]) for name, setting in ORB_SLAM_NOISE.items() if name in tree}
    return Calibration(tuple(cameras), noise)


def _orb_slam_camera(tree: Tree, name: str) -> PinholeCamera:
    model, coefficients = ORB_SLAM_LENSES[tree["Camera.type"]]
    return camera(
        (tree["Camera.width"], tree["Camera.height"]),
        [tree[f"{name}.{key}"] for key in ("fx", "fy", "cx", "cy")],
        model,
        [tree.get(f"{name}.{key}", 0.0) for key in coefficients],
    )


def of_vins(tree: Tree, path: Path) -> Calibration:
    """Return the content of VINS-Fusion's settings and of the cameras' files that they name, beside their own file."""
    offset_s = finite(tree.get("td", 0.0), "td")
    cameras = []
    for index in range(2):
        if f"cam{index}_calib" not in tree:
            break
        of_camera = path.parent / str(tree[f"cam{index}_calib"])
        try:
            found = _vins_camera(read_tree(of_camera))
        except KeyError as error:
            raise CalibrationError(f"{of_camera}: {error.args[0]} is missing") from None
        pose = tree.get(f"body_T_cam{index}")
        T_body_cam = None if pose is None else rigid_pose(pose["data"], f"body_T_cam{index}")
        cameras.append(CameraCalibration(found, T_body_cam, None, offset_s))
    return Calibration(tuple(cameras))


def _vins_camera(tree: Tree) -> PinholeCamera:
    """Return a camera of camodocal's file."""
    kind, projection = tree["model_type"], tree["projection_parameters"]
    if kind == "PINHOLE":
        model, focal, centre = "plumb_bob", ("fx", "fy"), ("cx", "cy")
        coefficients: list[Any] = [tree["distortion_parameters"][key] for key in ("k1", "k2", "p1", "p2")]
    elif kind == "KANNALA_BRANDT":
        model, focal, centre = "equidistant", ("mu", "mv"), ("u0", "v0")
        coefficients = [projection[key] for key in ("k2", "k3", "k4", "k5")]
    else:
        raise CalibrationError(f"model_type {kind!r} is not supported; use PINHOLE or KANNALA_BRANDT")
    size = tree["image_width"], tree["image_height"]
    return camera(size, [projection[key] for key in (*focal, *centre)], model, coefficients)
