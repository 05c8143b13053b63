# SPDX-License-Identifier: Apache-2.0
"""recorder: records the fleet's estimates to a rosbag2 (mcap) for the evaluation.

in   /<vehicle>/odometry, fused/odometry, ins/dead_reckoning, ground_truth/odometry    nav_msgs/Odometry
     /<vehicle>/fusion/status                                                          uav_vslam_msgs/FusionStatus
     /<vehicle>/slam/smoothed                                         geometry_msgs/PoseWithCovarianceStamped
     /<vehicle>/slam/quality                                                           uav_vslam_msgs/FrameQuality
     /diagnostics                                                                      diagnostic_msgs/DiagnosticArray
out  /diagnostics                                                                      the recorder's own status

Messages are written byte for byte, with their header stamps. The bag is complete after SIGINT or SIGTERM; where the
recorder was killed, its end and the last second are missing. While the disk is full, messages are dropped and counted,
and the status is ERROR; with room again, recording goes on. If it is full at the end, the exit code is 1.
"""

import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import Odometry
from rclpy.node import Node

from uav_vslam.config.files import expanded
from uav_vslam.config.nodes import RecorderNodeConfig
from uav_vslam.datasets.bag_recorder import RawRecorder
from uav_vslam.datasets.messages import header_stamp_ns
from uav_vslam.datasets.outputs import POSES, QUALITY, SMOOTHED, STATUS
from uav_vslam.datasets.unfinished import require_place
from uav_vslam.errors import BagError, ConfigError
from uav_vslam.ros.batches import Batches, take_waiting
from uav_vslam.ros.diagnostics import status_message
from uav_vslam.ros.inputs import Input
from uav_vslam.ros.message_types import type_name
from uav_vslam.ros.params import declare, read
from uav_vslam.ros.qos import SENSOR
from uav_vslam.ros.readiness import DiscoveryReport
from uav_vslam.ros.runtime import run_node
from uav_vslam.ros.timers import create_wall_timer
from uav_vslam_msgs.msg import FrameQuality, FusionStatus

VEHICLE_TOPICS = dict.fromkeys(POSES, Odometry) | {
    SMOOTHED: PoseWithCovarianceStamped,
    STATUS: FusionStatus,
    QUALITY: FrameQuality,
}
REPORT_S = 1.0
PERIOD_S = 0.1  # between batches
SILENCE_S = 10.0  # of wall time, without a message of a vehicle


class RecorderNode(Node):
    """Writes raw messages to a bag."""

    def __init__(self) -> None:
        super().__init__("recorder")
        own = read(self, RecorderNodeConfig)
        declare(self, own)
        output, vehicles = own.output, own.vehicles
        if not output or not vehicles:
            raise ConfigError("recorder: set the parameters output (folder to make) and vehicles (their names)")
        self._output = expanded(output, "output")
        require_place(self._output)
        self._output.parent.mkdir(parents=True, exist_ok=True)
        self._bag = RawRecorder(self._output, retrying=True)
        self._written = self._dropped = 0
        self._inputs: list[Input] = []
        self._newest_s: dict[str, float] = {}  # by vehicle: when its last message came
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        for vehicle in vehicles:
            for name, message_type in VEHICLE_TOPICS.items():
                self._record(f"/{vehicle}/{name}", message_type, vehicle)
        self._record("/diagnostics", DiagnosticArray, "")
        DiscoveryReport(self, self._unmatched)
        create_wall_timer(self, REPORT_S, self._report)
        create_wall_timer(self, PERIOD_S, self._take_messages)
        self.get_logger().info(f"recording to {self._output}")

    def finish(self) -> int:
        """Record what still waits, and close the bag; return the exit code."""
        code = 0
        self._take_messages()
        try:
            self._bag.close()
        except (BagError, OSError) as error:  # the latter where its folder was moved
            code = 1
            self.get_logger().error(str(error))
        lost = self._bag.lost
        text = f"{self._written - lost} messages recorded, {self._dropped} dropped"
        self.get_logger().info(f"{text}, {lost} lost with the end of the bag" if lost else text)
        return code

    def _record(self, topic: str, message_type: Any, vehicle: str) -> None:
        name, batches = type_name(message_type), Batches(at_once=True)

        def write(data: bytes) -> None:
            batches.at_once = False  # there are messages: its QoS suits the publisher
            self._newest_s[vehicle] = time.monotonic()
            try:
                stamp_ns = header_stamp_ns(data)
                if stamp_ns or topic != "/diagnostics":  # these are stamped 0 until the clock runs
                    self._bag.write(topic, name, data, stamp_ns)
                    self._written += 1
            except BagError as error:
                self._dropped += 1
                self.get_logger().error(f"not recorded: {error}", throttle_duration_sec=5.0)

        one = Input(message_type, topic, write, SENSOR, stands_for=topic, raw=True, group=batches, shared=True)
        one.subscribe(self)
        self._inputs.append(one)

    def _take_messages(self) -> None:
        for one in self._inputs:
            take_waiting(one.subscription)

    def _unmatched(self) -> list[str]:
        return [one.topic for one in self._inputs if one.subscription.get_publisher_count() == 0]

    def _report(self) -> None:
        for one in self._inputs:
            one.follow(self)
        if not self._bag.is_full():
            self._bag.flush()
        values = {"written": str(self._written), "dropped": str(self._dropped)}
        level, text = self._health()
        self._diagnostics.publish(status_message("fleet: recorder", values, level=level, text=text))

    def _health(self) -> tuple[bytes, str]:
        """Return level and text of the status."""
        if self._bag.is_full():
            return DiagnosticStatus.ERROR, f"the disk of {self._output} is full: {self._dropped} messages not recorded"
        if silent := self._silent_vehicles():
            return (
                DiagnosticStatus.WARN,
                f"recording, but nothing comes from {', '.join(silent)}, whose nodes are there",
            )
        if self._dropped:
            return DiagnosticStatus.WARN, f"recording; {self._dropped} messages were not recorded"
        return DiagnosticStatus.OK, "recording"

    def _silent_vehicles(self) -> list[str]:
        """Return the vehicles that have publishers, but whose messages have ceased to come, and for how long."""
        now_s = time.monotonic()
        return [
            f"{vehicle} for {now_s - newest_s:.0f} s"
            for vehicle, newest_s in self._newest_s.items()
            if now_s - newest_s > SILENCE_S and self._publishes(vehicle)
        ]

    def _publishes(self, vehicle: str) -> bool:
        topics = (one for one in self._inputs if one.topic.startswith(f"/{vehicle}/"))
        return any(one.subscription.get_publisher_count() for one in topics)


def main(args: list[str] | None = None) -> int:
    """Entry point."""
    return run_node(RecorderNode, args)


if __name__ == "__main__":
    raise SystemExit(main())
