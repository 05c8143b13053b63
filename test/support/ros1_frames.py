# SPDX-License-Identifier: Apache-2.0
"""Static frames as ROS 1's `tf static_transform_publisher` leaves them: again and again on /tf."""

from pathlib import Path

import numpy as np

from uav_vslam.datasets.bag_recorder import RawRecorder
from uav_vslam.datasets.cdr import decode, encode
from uav_vslam.datasets.frame_tree import TF, TF_STATIC
from uav_vslam.datasets.message_builders import transforms_message
from uav_vslam.datasets.messages import transforms_of
from uav_vslam.datasets.rosbag import iter_raw
from uav_vslam.geometry.pose import Pose

STEP_M = 0.1  # of what moves, from one message to the next


def repeated_on_tf(source: Path, out: Path, *, moving: str = "") -> Path:
    """Copy a bag with the content of /tf_static on /tf, beside the vehicle's pose; one frame there may move, too."""
    edges, _ = transforms_of(decode(next(iter_raw([source], [TF_STATIC]))))
    moved_m = np.zeros(3)
    with RawRecorder(out) as recorder:
        for raw in iter_raw([source]):
            if raw.topic != TF_STATIC:
                recorder.write(raw.topic, raw.msgtype, raw.data, raw.stamp_ns)
            if raw.topic == "/uav1/left/image_raw":
                moved_m = moved_m + STEP_M
                flown = [("map", "uav1/base_link", Pose(np.eye(3), moved_m))]
                sensors = [(parent, child, T @ flown[0][2] if child == moving else T) for parent, child, T in edges]
                built = transforms_message(raw.stamp_ns, flown + sensors)
                recorder.write(TF, "tf2_msgs/msg/TFMessage", encode(built), raw.stamp_ns)
    return out
