# SPDX-License-Identifier: Apache-2.0
"""bare_odometry: the least that an ordinary node in Python can do, as the yardstick of `uav-vslam bench --nodes`.

in   imu/data_raw     sensor_msgs/Imu
out  bare/odometry    nav_msgs/Odometry, the same message for each reading
"""

from nav_msgs.msg import Odometry
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from sensor_msgs.msg import Imu

from uav_vslam.ros.qos import SENSOR, STATE
from uav_vslam.ros.runtime import run_node
from uav_vslam.ros.timers import create_wall_timer


class BareOdometryNode(Node):
    """Takes readings and publishes odometry; computes nothing."""

    def __init__(self) -> None:
        super().__init__("bare_odometry")
        self._message = Odometry()
        self._odometry = self.create_publisher(Odometry, "bare/odometry", STATE)
        self.create_subscription(Imu, "imu/data_raw", self._on_imu, SENSOR)
        create_wall_timer(self, 1.0, lambda: None)  # Python handles a signal only when the executor wakes

    def _on_imu(self, message: Imu) -> None:
        self._message.header.stamp = message.header.stamp
        self._odometry.publish(self._message)


def main(args: list[str] | None = None) -> int:
    """Entry point."""
    return run_node(BareOdometryNode, args, executor_type=SingleThreadedExecutor)


if __name__ == "__main__":
    raise SystemExit(main())
