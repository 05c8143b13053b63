# SPDX-License-Identifier: Apache-2.0
"""A stranger's recordings, as `uav-vslam study recordings` makes them."""

from uav_vslam.studies.recordings.foreign import (
    UPSIDE_DOWN,
    edited,
    kalibr_of,
    renamed,
    rewritten,
    shifted,
    turned,
    with_imu_edge,
    without,
)

T_BODY_IMU = UPSIDE_DOWN

__all__ = [
    "T_BODY_IMU",
    "edited",
    "kalibr_of",
    "renamed",
    "rewritten",
    "shifted",
    "turned",
    "with_imu_edge",
    "without",
]
