# SPDX-License-Identifier: Apache-2.0
"""Start a fleet on this computer: `ros2 launch uav_vslam fleet.launch.py fleet:=FILE`, as `uav-vslam launch FILE`."""

from uav_vslam.ros.launch_description import description


def generate_launch_description():
    """Entry point of `ros2 launch`."""
    return description(one_vehicle=False)
