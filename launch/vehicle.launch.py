# SPDX-License-Identifier: Apache-2.0
"""Start one vehicle of a fleet on its own computer, as `uav-vslam launch FILE --vehicle uav1` does.

`ros2 launch uav_vslam vehicle.launch.py fleet:=FILE vehicle:=uav1`
"""

from uav_vslam.ros.launch_description import description


def generate_launch_description():
    """Entry point of `ros2 launch`."""
    return description(one_vehicle=True)
