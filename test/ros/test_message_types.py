# SPDX-License-Identifier: Apache-2.0
"""Types of messages are found by their names, and a missing one is named with its topic."""

import pytest

pytest.importorskip("rclpy", reason="needs ROS")
from sensor_msgs.msg import Imu

from uav_vslam.errors import UavVslamError
from uav_vslam.ros.message_types import type_name, type_named


def test_a_type_is_found_by_its_name() -> None:
    assert type_named(type_name(Imu), topic="/imu") is Imu


@pytest.mark.parametrize("name", ["nowhere_msgs/msg/Imu", "sensor_msgs/msg/Nothing"])
def test_a_type_that_is_not_installed_is_named_with_its_topic(name: str) -> None:
    with pytest.raises(UavVslamError, match=f"/imu: {name} is not installed"):
        type_named(name, topic="/imu")
