# SPDX-License-Identifier: Apache-2.0
"""The record of a frame as a message; `datasets.outputs` reads it back from a bag."""

from uav_vslam.ros.convert import header
from uav_vslam.types import FrameQuality
from uav_vslam_msgs.msg import FrameQuality as FrameQualityMsg


def quality_to_msg(quality: FrameQuality, *, frame_id: str) -> FrameQualityMsg:
    """Return the message."""
    return FrameQualityMsg(
        header=header(quality.stamp_ns, frame_id),
        features=quality.features,
        tracked=quality.tracked,
        associated=quality.associated,
        downweighted=quality.downweighted,
        landmarks=quality.landmarks,
        coasted=quality.coasted,
        relocalised=quality.relocalised,
        restarted=quality.restarted,
        closures=quality.closures,
        nis=quality.nis,
        dof=quality.dof,
        gate_probability=quality.gate_probability,
        events=list(quality.events),
        time_offset_s=quality.time_offset_s,
        time_offset_sigma_s=quality.time_offset_sigma_s,
        disparity_error_px=quality.disparity_error_px,
        disparity_error_sigma_px=quality.disparity_error_sigma_px,
    )
