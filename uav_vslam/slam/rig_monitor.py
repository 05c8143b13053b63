# SPDX-License-Identifier: Apache-2.0
"""Do the data contradict the calibration of a rig that was declared rigid?

A right camera that is turned about the axis which changes disparity leaves no trace in the residuals, but a filter that
keeps even the smallest doubt of the calibration sees what the motion says about it, see `Filter.rig_evidence`.
"""

from uav_vslam.config import RigConfig
from uav_vslam.slam.backend import FrameReport

CONTRADICTED = 40.0  # chi-square with 3 degrees of freedom: a right rig exceeds it once in a hundred million frames


class RigMonitor:
    """Watches the evidence and warns once; a flexing rig is estimated anyway."""

    def __init__(self, config: RigConfig) -> None:
        self._watching = not config.flexing

    def add(self, report: FrameReport) -> str:
        """Take note of a frame and return a warning, empty as a rule and after the first."""
        if not self._watching or report.rig_evidence < CONTRADICTED:
            return ""
        self._watching = False
        return (
            "the motion contradicts the cameras' mutual attitude as calibrated "
            f"(chi-square {report.rig_evidence:.0f} of 3): calibrate again, or set rig.flexing to have it estimated"
        )
