# SPDX-License-Identifier: Apache-2.0
"""Odometry as serialised data, for a node that publishes it often: a quarter of the time that messages take."""

import struct

import numpy as np
from nav_msgs.msg import Odometry
from rclpy.serialization import serialize_message

from uav_vslam.ros.convert import header
from uav_vslam.types import NS_PER_S, PoseEstimate, Twist

STAMP = 4  # after the four bytes that state the encoding
NUMBERS = 7 + 36 + 6 + 36  # position, quaternion, covariance, twist, covariance: the end of the message


class OdometryData:
    """Writes nav_msgs/Odometry between two frames: only its stamp and numbers differ from one to the next."""

    def __init__(self, *, frame_id: str, child_frame_id: str) -> None:
        empty = Odometry(header=header(0, frame_id), child_frame_id=child_frame_id)
        self._data = bytearray(serialize_message(empty))
        self._numbers = np.frombuffer(self._data, float, NUMBERS, len(self._data) - 8 * NUMBERS)

    def of(self, pose: PoseEstimate, twist: Twist) -> bytes:
        """Return what serialisation makes of `convert.odometry_to_msg`."""
        w, x, y, z = pose.T_map_body.quaternion_wxyz
        parts = (pose.T_map_body.t, (x, y, z, w), pose.covariance.ravel())
        np.concatenate((*parts, twist.linear, twist.angular, twist.covariance.ravel()), out=self._numbers)
        struct.pack_into("=iI", self._data, STAMP, *divmod(pose.stamp_ns, NS_PER_S))
        return bytes(self._data)
