# SPDX-License-Identifier: Apache-2.0
"""Errors of a stereo rig's calibration, each drawn independently of the others.

So are the errors that come after a calibration, from temperature, handling and mounting. Those of the calibration
itself are correlated and cancel in part; `board` has them. Constant errors of the disparity are drawn for no seed.
"""

import dataclasses
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from uav_vslam.geometry.camera import PinholeCamera
from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.stereo import StereoRig
from uav_vslam.simulation.rig import rotated_right
from uav_vslam.studies.perturbed.board import PAIRS, BoardCalibration

Array = NDArray[np.float64]

STREAM = 0x0CA1  # of the random numbers, beside those of the flights

# Standard deviations, about those that calibration reports give. 0.01 degrees and 0.2 px of principal point each change
# the disparity of the Kagaru rig by 0.3 px, of the size of the constant 0.2 px that EuRoC V1_01 contains.
FOCAL = 5e-4  # relative, of each camera
PRINCIPAL_POINT_PX = 0.2  # of each coordinate and camera, in images of 1280 x 960 px
ATTITUDE_DEG = 0.01  # of the right camera against the left one, about each axis
BASELINE = 1e-3  # relative
TIME_OFFSET_S = 1e-3  # of the camera clock against the IMU's


@dataclass(frozen=True, slots=True)
class CalibrationError:
    """What is wrong with a calibration: the assumed values less the true ones.

    Attributes:
        focal: (2,) relative, of the left and the right camera.
        principal_point_px: (2, 2) of each camera, u and v [px].
        attitude_rad: (3,) of the right camera, about its own axes [rad].
        baseline: relative.
        time_offset_s: assumed stamps of the images less the true ones, on the IMU's clock [s].
        disparity_px: of the right principal point along the disparity [px].
    """

    focal: Array = dataclasses.field(default_factory=lambda: np.zeros(2))
    principal_point_px: Array = dataclasses.field(default_factory=lambda: np.zeros((2, 2)))
    attitude_rad: Array = dataclasses.field(default_factory=lambda: np.zeros(3))
    baseline: float = 0.0
    time_offset_s: float = 0.0
    disparity_px: float = 0.0

    def applied(self, rig: StereoRig) -> StereoRig:
        """Return the rig as the calibration has it."""
        left, right = (
            _assumed_camera(camera, self.focal[side], self.principal_point_px[side])
            for side, camera in enumerate((rig.left, rig.right))
        )
        turned = rotated_right(rig, self.attitude_rad)
        start, end = rig.T_body_left.t, rig.T_body_right.t
        T_body_right = Pose(turned.T_body_right.R, start + (1.0 + self.baseline) * (end - start))
        return StereoRig(left, right, rig.T_body_left, T_body_right).disparity_shifted(self.disparity_px)


EXACT = "exact"
ALL = "all of these"
BOARD = f"calibrated with {PAIRS} board pairs"
FIELDS = {  # that are wrong, by condition
    EXACT: (),
    f"focal length, {FOCAL:.2%}": ("focal",),
    f"principal point, {PRINCIPAL_POINT_PX:g} px": ("principal_point_px",),
    f"right camera's attitude, {ATTITUDE_DEG:g} deg": ("attitude_rad",),
    f"baseline, {BASELINE:.1%}": ("baseline",),
    f"time offset, {1e3 * TIME_OFFSET_S:g} ms": ("time_offset_s",),
    ALL: ("focal", "principal_point_px", "attitude_rad", "baseline", "time_offset_s"),
}

DISPARITIES = {f"disparity, {error_px:g} px": error_px for error_px in (0.2, 0.3)}  # the same for all seeds
CONDITIONS = (*FIELDS, *DISPARITIES, BOARD)


def errors_of(seed: int) -> dict[str, CalibrationError | BoardCalibration]:
    """Return the calibration of each condition; the single errors are those of ALL, one at a time."""
    rng = np.random.default_rng(np.random.SeedSequence([seed, STREAM]))
    whole = CalibrationError(
        focal=rng.normal(0.0, FOCAL, 2),
        principal_point_px=rng.normal(0.0, PRINCIPAL_POINT_PX, (2, 2)),
        attitude_rad=rng.normal(0.0, np.deg2rad(ATTITUDE_DEG), 3),
        baseline=float(rng.normal(0.0, BASELINE)),
        time_offset_s=float(rng.normal(0.0, TIME_OFFSET_S)),
    )
    errors: dict[str, CalibrationError | BoardCalibration] = {
        condition: CalibrationError(**{name: getattr(whole, name) for name in names})
        for condition, names in FIELDS.items()
    }
    constant = {condition: CalibrationError(disparity_px=error_px) for condition, error_px in DISPARITIES.items()}
    return errors | constant | {BOARD: BoardCalibration(seed)}


def _assumed_camera(camera: PinholeCamera, focal: float, shift_px: Array) -> PinholeCamera:
    cx, cy = (camera.centre + shift_px).tolist()
    return dataclasses.replace(camera.magnified(float(focal)), cx=cx, cy=cy)
