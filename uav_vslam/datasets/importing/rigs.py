# SPDX-License-Identifier: Apache-2.0
"""The stereo rig of calibration files, or of the values of a layout, in the axes of the IMU."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from uav_vslam.datasets.calibration_files import read_calibration
from uav_vslam.datasets.camera_calibration import camera, rigid_pose
from uav_vslam.datasets.importing.kagaru_settings import CalibrationSettings
from uav_vslam.errors import CalibrationError, ConfigError
from uav_vslam.geometry.camera import PinholeCamera
from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.stereo import StereoRig
from uav_vslam.types import NS_PER_S


def rig_of_files(files: Sequence[Path]) -> tuple[StereoRig, int]:
    """Return the rig at the IMU, and the IMU's time minus the images' stamps [ns].

    Raises:
        CalibrationError: a file can't be read, or two cameras and their place at the IMU are not in them.
    """
    calibration = read_calibration(files)
    T_imu_left, T_imu_right = calibration.T_body_cam(0), calibration.T_body_cam(1)
    if T_imu_left is None or T_imu_right is None:
        names = ", ".join(map(str, files))
        raise CalibrationError(f"{names}: two cameras with T_cam_imu are needed; use a camchain-imucam file of Kalibr")
    left, right = (one.camera for one in calibration.cameras)
    with _naming(", ".join(map(str, files))):
        rig = StereoRig(left, right, T_imu_left, T_imu_right)
    return rig, round(calibration.time_offset_s * NS_PER_S)


def rig_of_values(given: CalibrationSettings, layout_file: Path) -> StereoRig:
    """Return the rig at the IMU from the numbers of a layout.

    Raises:
        ConfigError: numbers are missing.
        CalibrationError: they are no calibration.
    """
    if not len(given.size) == 2:
        raise ConfigError(f"{layout_file}: calibration needs files, or size and the values below it")
    sides: list[PinholeCamera] = []
    for name, lens in (("left", given.left), ("right", given.right)):
        if len(lens.intrinsics) != 4:
            raise ConfigError(f"{layout_file}: calibration.{name}.intrinsics needs fx, fy, cx, cy")
        with _naming(f"{layout_file}: calibration.{name}"):
            sides.append(camera(given.size, lens.intrinsics, lens.model, lens.distortion))
    T_imu_left = _pose(given.T_imu_left, f"{layout_file}: calibration.T_imu_left")
    T_left_right = _pose(given.T_left_right, f"{layout_file}: calibration.T_left_right")
    left, right = sides
    with _naming(f"{layout_file}: calibration"):
        return StereoRig(left, right, T_imu_left, T_imu_left @ T_left_right)


def turned(rig: StereoRig, R_body_imu: NDArray[np.float64]) -> StereoRig:
    """Return the rig in axes that are turned against those of the IMU."""
    T_body_imu = Pose(R_body_imu, np.zeros(3))
    return StereoRig(rig.left, rig.right, T_body_imu @ rig.T_body_left, T_body_imu @ rig.T_body_right)


@contextmanager
def _naming(source: str) -> Iterator[None]:
    """Let errors begin with what the calibration was read from."""
    try:
        yield
    except CalibrationError as error:
        raise CalibrationError(f"{source}: {error}") from None


def _pose(numbers: Sequence[float], name: str) -> Pose:
    if len(numbers) != 16:
        raise ConfigError(f"{name} has {len(numbers)} numbers; give a 4x4 matrix by rows")
    return rigid_pose(numbers, name)
