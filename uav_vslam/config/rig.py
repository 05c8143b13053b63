# SPDX-License-Identifier: Apache-2.0
"""Uncertainty of the stereo calibration."""

from dataclasses import dataclass

from uav_vslam.config.settings import Settings, refuse, setting

LEAST_DISPARITY_SIGMA_PX = 1e-6  # a smaller one makes the information singular to working precision


@dataclass(frozen=True, slots=True)
class RigConfig(Settings):
    """Uncertainty of the calibration: right camera's attitude and focal length, disparity, and the cameras' clock."""

    flexing: bool = setting(False, "the cameras' relative attitude drifts and vibrates, so it is estimated")
    attitude_sigma_deg: float = setting(
        0.05,
        "flexing: initial error of the attitude's slow part, per axis; best set to twice the expected",
        unit="deg",
        at_least=0,
        at_most=180,
    )
    attitude_walk_deg: float = setting(
        0.001, "flexing: random walk of the attitude's slow part", unit="deg/sqrt(s)", at_least=0, at_most=180
    )
    vibration_sigma_deg: float = setting(
        0.05,
        "flexing: part of the attitude that is independent in each frame, rms per axis",
        unit="deg",
        at_least=0,
        at_most=180,
    )
    rigid_sigma_deg: float = setting(
        2.0e-4,
        "not flexing: error of the attitude about the axis that changes the disparity, if the calibration is right; "
        "0: the attitude is exact about every axis",
        unit="deg",
        at_least=0,
        at_most=180,
    )
    epipolar_sigma_deg: float = setting(
        0.05,
        "not flexing: error of the attitude about the axes that don't change the disparity; each stereo pair shows it",
        unit="deg",
        at_least=0,
        at_most=180,
    )
    disparity_sigma_px: float = setting(
        0.004, "constant error of the disparity, estimated, if the calibration is right; 0: none", unit="px", at_least=0
    )
    miscalibrated_sigma_px: float = setting(
        0.3,
        "not flexing: constant error of the disparity if the calibration is wrong, which the motion shows",
        unit="px",
        above=0,
        at_most=1000,
    )
    miscalibrated_probability: float = setting(
        0.2, "not flexing: probability before the flight that the calibration is wrong; 0: never", at_least=0, below=1
    )
    focal_ratio_sigma: float = setting(
        3.0e-3,
        "focal length of the right camera over the left one's, relative error, estimated; 0: none",
        at_least=0,
        at_most=0.1,
    )
    time_offset_sigma_s: float = setting(
        3.0e-3, "camera clock against IMU clock, estimated; 0: they are equal", unit="s", at_least=0
    )
    readout_s: float = setting(
        0.0,
        "rolling shutter: from the exposure of an image's first row to that of the last, negative if that is the "
        "earlier one; 0: a global shutter",
        unit="s",
        at_least=-0.1,
        at_most=0.1,
    )

    def _check_together(self) -> None:
        if 0.0 < self.disparity_sigma_px < LEAST_DISPARITY_SIGMA_PX:
            refuse(
                "disparity_sigma_px", self.disparity_sigma_px, f"0 for none, or at least {LEAST_DISPARITY_SIGMA_PX:g}"
            )
        if self.disparity_sigma_px > self.miscalibrated_sigma_px:
            refuse(
                "miscalibrated_sigma_px",
                self.miscalibrated_sigma_px,
                f"at least disparity_sigma_px, which is {self.disparity_sigma_px:g}",
            )


# No error of the calibration is a state.
EXACT_RIG = RigConfig(rigid_sigma_deg=0.0, disparity_sigma_px=0.0, focal_ratio_sigma=0.0, time_offset_sigma_s=0.0)
