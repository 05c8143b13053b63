# SPDX-License-Identifier: Apache-2.0
"""Detects a wrong calibration of a rig that was declared rigid.

Neither a right camera that is turned about the disparity axis nor a principal point that is off shows in the residuals,
but a filter that estimates such errors can test the calibration against the motion: by its estimate of the disparity's
error, see `DisparityPrior`, and for the rest by `Filter.rig_evidence`.
"""

from scipy.special import chdtri

from uav_vslam.config import RigConfig
from uav_vslam.slam.frame_report import FrameReport

FALSE_ALARM = 1e-8  # probability that a correct rig is said to be contradicted, per frame
MISCALIBRATED = 0.99  # probability of a wrong calibration


class RigMonitor:
    """Monitors the evidence and warns once; not needed as soon as a rig counts as flexing: then it is estimated."""

    def __init__(self, config: RigConfig) -> None:
        self._watching = not config.flexing
        single = config.disparity_sigma_px, config.focal_ratio_sigma
        self._dof = 3 * (config.rigid_sigma_deg > 0) + sum(sigma > 0 for sigma in single)
        self._contradicted = float(chdtri(max(1, self._dof), FALSE_ALARM))

    def add(self, report: FrameReport) -> str:
        """Add a frame and return a warning, normally empty, and empty after the first."""
        finding = self._finding(report) if self._watching and not report.flexing else ""
        if not finding:
            return ""
        self._watching = False
        return f"the motion contradicts the calibration of the cameras: {finding}"

    def _finding(self, report: FrameReport) -> str:
        error = report.disparity
        if error is not None and error.miscalibrated > MISCALIBRATED:
            return (
                f"the disparity is off by {error.mean_px:+.2f} px (1 sigma {error.sigma_px:.2f} px), which is now "
                "estimated: recalibrate, and set rig.miscalibrated_probability to 0.5 until then, or rig.flexing if it "
                "bends; an IMU that is noisier than imu.* says, or whose clock is off, looks the same (`uav-vslam "
                "check` measures both), and so does a wrong start velocity, if one was warned of"
            )
        if report.rig_evidence > self._contradicted:
            return (
                f"chi-square {report.rig_evidence:.0f} of {self._dof}: recalibrate, or have the error estimated; "
                "set rig.miscalibrated_sigma_px higher if it is constant, rig.flexing if the rig bends"
            )
        return ""
