# SPDX-License-Identifier: Apache-2.0
"""What comes of a frame: the estimate, and what else is told of it."""

from dataclasses import dataclass

from uav_vslam.slam.frame_report import FrameReport
from uav_vslam.types import FrameQuality, ImuIncrement, JointInformation, NavEstimate


@dataclass(frozen=True, slots=True)
class FrameOutput:
    """All outputs of a frame.

    Attributes:
        report: own-only SLAM.
        dead_reckoning: the uncorrected INS at the same stamp.
        joint: the estimate of pose and landmarks, at epochs only.
        increment: the motion since the frame before that the back end used; None at the start itself.
        warnings: problems for the user; normally none.
        readout_s: of the cameras' rolling shutter, as it was undone [s].
        earlier: outputs of all frames before, where these have been used again; normally none.
    """

    report: FrameReport
    dead_reckoning: NavEstimate
    joint: JointInformation | None
    increment: ImuIncrement | None
    warnings: tuple[str, ...] = ()
    readout_s: float = 0.0
    earlier: tuple["FrameOutput", ...] = ()

    @property
    def quality(self) -> FrameQuality:
        """How the frame went, judged without ground truth."""
        report, innovation = self.report, self.report.innovation
        offset, disparity = report.time_offset, report.disparity
        return FrameQuality(
            stamp_ns=report.pose.stamp_ns,
            features=report.features,
            tracked=report.tracked,
            associated=report.associated,
            downweighted=innovation.downweighted if innovation else 0,
            landmarks=report.landmarks,
            coasted=report.coasted,
            relocalised=report.relocalised,
            restarted=report.recovery != "",
            closures=report.closures,
            nis=innovation.nis if innovation else 0.0,
            dof=innovation.dof if innovation else 0,
            gate_probability=report.gate_probability,
            events=self.warnings,
            time_offset_s=offset.mean_s if offset else 0.0,
            time_offset_sigma_s=offset.sigma_s if offset else 0.0,
            disparity_error_px=disparity.mean_px if disparity else 0.0,
            disparity_error_sigma_px=disparity.sigma_px if disparity else 0.0,
        )
