# SPDX-License-Identifier: Apache-2.0
"""Detects a wrong calibration of a rig that was declared rigid.

A right camera rotated about the disparity axis does not show in the residuals, but a filter with even a small
calibration uncertainty can test it against the motion, see `Filter.rig_evidence`.
"""

from scipy.special import chdtri

from uav_vslam.config import RigConfig
from uav_vslam.slam.backend import FrameReport

FALSE_ALARM = 1e-8  # probability that a correct rig is said to be contradicted, per frame


class RigMonitor:
    """Monitors the evidence and warns once; not needed for a flexing rig, which is estimated."""

    def __init__(self, config: RigConfig) -> None:
        self._watching = not config.flexing
        self._dof = 3 * (config.rigid_sigma_deg > 0) + (config.disparity_sigma_px > 0)
        self._contradicted = float(chdtri(max(1, self._dof), FALSE_ALARM))

    def add(self, report: FrameReport) -> str:
        """Add a frame and return a warning, normally empty, and empty after the first."""
        if not self._watching or report.rig_evidence < self._contradicted:
            return ""
        self._watching = False
        return (
            "the motion contradicts the calibration of the cameras "
            f"(chi-square {report.rig_evidence:.0f} of {self._dof}): recalibrate, or have the error estimated; "
            "set rig.disparity_sigma_px to 0.2 or more if it is constant, rig.flexing if the rig bends"
        )
