# SPDX-License-Identifier: Apache-2.0
"""A stereo rig as Kalibr's camchain, which `calibration_files` reads."""

from typing import Any

from uav_vslam.errors import CalibrationError
from uav_vslam.geometry.camera import PinholeCamera
from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.stereo import StereoRig

KALIBR_LENSES = {"radtan": "plumb_bob", "equidistant": "equidistant"}  # Kalibr's names of models of `PinholeCamera`
KALIBR_NAMES = {model: name for name, model in KALIBR_LENSES.items()}
COEFFICIENTS = 4  # of either


def kalibr_knows(rig: StereoRig) -> bool:
    """Return whether Kalibr has the models of both lenses, without further coefficients."""
    return all(
        camera.model in KALIBR_NAMES and not camera.distortion[COEFFICIENTS:].any() for camera in (rig.left, rig.right)
    )


def camchain(rig: StereoRig, *, T_body_imu: Pose | None = None, time_offset_s: float = 0.0) -> dict[str, Any]:
    """Return what Kalibr writes for two cameras.

    Args:
        rig: cameras.
        T_body_imu: pose of the IMU; None for a camchain without it.
        time_offset_s: IMU time minus image stamp [s], written with the IMU.

    Raises:
        CalibrationError: Kalibr does not know the lenses.
    """
    if not kalibr_knows(rig):
        raise CalibrationError(
            f"Kalibr has no {rig.left.model} and {rig.right.model} lenses with these coefficients; it has "
            f"{' and '.join(KALIBR_NAMES)} with {COEFFICIENTS}"
        )
    tree = {"cam0": _intrinsics(rig.left), "cam1": _intrinsics(rig.right)}
    tree["cam1"]["T_cn_cnm1"] = rig.T_right_left.matrix.tolist()
    if T_body_imu is not None:
        for camera, T_body_cam in zip(tree.values(), (rig.T_body_left, rig.T_body_right), strict=True):
            camera["T_cam_imu"] = (T_body_cam.inverse() @ T_body_imu).matrix.tolist()
            camera["timeshift_cam_imu"] = time_offset_s
    return tree


def _intrinsics(camera: PinholeCamera) -> dict[str, Any]:
    return {
        "camera_model": "pinhole",
        "intrinsics": [float(value) for value in (camera.fx, camera.fy, camera.cx, camera.cy)],
        "distortion_model": KALIBR_NAMES[camera.model],
        "distortion_coeffs": camera.distortion[:COEFFICIENTS].tolist(),
        "resolution": [camera.width, camera.height],
    }
