# SPDX-License-Identifier: Apache-2.0
"""What calibration files say of a vehicle's cameras and IMU, and what each of their kinds is read with."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uav_vslam.datasets.kalibr_camchain import KALIBR_LENSES
from uav_vslam.datasets.stereo_sync import NOTABLE_OFFSET_NS
from uav_vslam.errors import CalibrationError
from uav_vslam.geometry.camera import COEFFICIENTS, PinholeCamera
from uav_vslam.geometry.pose import Pose
from uav_vslam.types import NS_PER_S

Array = NDArray[np.float64]

# What other tools call the models of `PinholeCamera`; none of the other names is one.
LENS_MODELS = {
    "": "plumb_bob",
    "none": "plumb_bob",
    "radial-tangential": "plumb_bob",
    "fisheye": "equidistant",
    "kannala_brandt4": "equidistant",
    **KALIBR_LENSES,
}
ORTHOGONAL = 5e-3  # largest deviation of R R^T from the identity: three decimals


@dataclass(frozen=True, slots=True)
class CameraCalibration:
    """One camera of a calibration.

    Attributes:
        camera: intrinsics.
        T_body_cam: pose of the optical frame, None if the file has none.
        T_left_cam: pose in the left camera's frame, None likewise.
        time_offset_s: IMU time minus image stamp [s].
        name: in a file of several cameras.
    """

    camera: PinholeCamera
    T_body_cam: Pose | None = None
    T_left_cam: Pose | None = None
    time_offset_s: float = 0.0
    name: str = ""


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


def camera(size: Sequence[Any], intrinsics: Sequence[Any], model: str, coefficients: Sequence[Any]) -> PinholeCamera:
    """Return a camera from the numbers of a file or message.

    Args:
        size: width and height [px].
        intrinsics: fx, fy, cx, cy [px].
        model: distortion model as any of the tools calls it.
        coefficients: of the lens; trailing zeros may be missing, and some drivers fill an array of one length.

    Raises:
        CalibrationError: the model is not supported or a number is missing.
    """
    model = LENS_MODELS.get(model, model)
    distortion = np.array([float(value) for value in coefficients])
    count = COEFFICIENTS.get(model, len(distortion))
    if model != "equidistant":  # whose zeros are a lens
        distortion = np.concatenate([distortion, np.zeros(max(0, count - len(distortion)))])
    if not distortion[count:].any():
        distortion = distortion[:count]
    width, height = map(int, size)
    fx, fy, cx, cy = map(float, intrinsics)
    return PinholeCamera(width, height, fx, fy, cx, cy, distortion, model)


def pose_in_pair(P: Array, R_pair_cam: Array) -> Pose | None:
    """Return the pose of a camera in the rectified frame of its stereo pair; None if it is not filled in.

    Args:
        P: (3, 4) projection matrix K' [I | t], where t leads from the pair's frame, the left camera's, to this one.
        R_pair_cam: its rectifying rotation.
    """
    if not (P[0, 0] > 0 and P[1, 1] > 0 and np.isfinite(P).all() and is_rotation(R_pair_cam)):
        return None
    return Pose(R_pair_cam, -np.array([P[0, 3] / P[0, 0], P[1, 3] / P[1, 1], 0.0]))


def finite(value: Any, name: str) -> float:
    """Return a number of a file; raises `ValueError` with its name if it is none."""
    number = float(value)
    if not math.isfinite(number):
        raise ValueError(f"{name} is {value}")
    return number


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
