# SPDX-License-Identifier: Apache-2.0
"""Detects a wrong calibration of a rig that was declared rigid.

A right camera rotated about the disparity axis does not show in the residuals, but a filter with even a small
calibration uncertainty can test it against the motion, see `Filter.rig_evidence`.
"""

from uav_vslam.config import RigConfig
from uav_vslam.slam.backend import FrameReport

CONTRADICTED = 40.0  # chi-square with 3 degrees of freedom: a correct rig exceeds it once in 10^8 frames


class RigMonitor:
    """Monitors the evidence and warns once; not needed for a flexing rig, which is estimated."""

    def __init__(self, config: RigConfig) -> None:
        self._watching = not config.flexing

    def add(self, report: FrameReport) -> str:
        """Add a frame and return a warning, normally empty, and empty after the first."""
        if not self._watching or report.rig_evidence < CONTRADICTED:
            return ""
        self._watching = False
        return (
            "the motion contradicts the calibrated relative attitude of the cameras "
            f"(chi-square {report.rig_evidence:.0f} of 3): recalibrate, or set rig.flexing to estimate it"
        )
