# SPDX-License-Identifier: Apache-2.0
"""Plays one vehicle's back end in real time from a file of serialised messages, and notes what its fusion node says.

usage: player.py MESSAGES.pickle START RESULT.json      START: wall time at which the first message is due [s]
"""

import json
import pickle
import sys
import time
from pathlib import Path

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import Odometry

from uav_vslam.datasets.messages import stamp_ns_of
from uav_vslam.ros.qos import NEWEST, SENSOR, STATE
from uav_vslam.types import NS_PER_S
from uav_vslam_msgs.msg import FusionStatus, JointInformation

TYPES = {"odometry": Odometry, "joint_information": JointInformation}


def main(messages: Path, start_s: float, result: Path) -> None:
    """Play and listen."""
    recorded = pickle.loads(messages.read_bytes())  # [(stamp_ns, topic, bytes)]
    vehicle = recorded["vehicle"]
    rclpy.init()
    node = rclpy.create_node("player", namespace=f"/{vehicle}")
    publishers = {topic: node.create_publisher(kind, topic, NEWEST) for topic, kind in TYPES.items()}
    received = {"fused": [], "status": [], "diagnostics": {}}

    def on_fused(message: Odometry) -> None:
        at = message.pose.pose.position
        of_position = message.pose.covariance.reshape(6, 6)[:3, :3].ravel().tolist()
        received["fused"].append((stamp_ns_of(message), at.x, at.y, at.z, *of_position))

    def on_status(message: FusionStatus) -> None:
        own = {
            name: getattr(message, name)
            for name in (
                *("mode", "packets_sent", "packets_held_back", "bytes_sent", "sent_bytes_per_s"),
                *("wire_sent_bytes", "wire_received_bytes", "wire_sent_bytes_per_s"),
            )
        }
        names = ("peer", "packets_received", "packets_used", "received_bytes", "common_landmarks", "age_s", "silent")
        received["status"].append({**own, "peers": [{n: getattr(peer, n) for n in names} for peer in message.peers]})

    def on_diagnostics(message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name.endswith(": fusion"):
                received["diagnostics"] = {entry.key: entry.value for entry in status.values}

    node.create_subscription(Odometry, "fused/odometry", on_fused, SENSOR)
    node.create_subscription(FusionStatus, "fusion/status", on_status, STATE)
    node.create_subscription(DiagnosticArray, "/diagnostics", on_diagnostics, 10)
    first_ns = recorded["messages"][0][0]
    for stamp_ns, topic, data in recorded["messages"]:
        due_s = start_s + (stamp_ns - first_ns) / NS_PER_S
        rclpy.spin_once(node, timeout_sec=0.0)  # even where it is late
        while time.time() < due_s:
            rclpy.spin_once(node, timeout_sec=max(due_s - time.time(), 0.0))
        publishers[topic].publish(data)
    end_s = time.time() + 2.0
    while time.time() < end_s:
        rclpy.spin_once(node, timeout_sec=0.1)
    received["frames"] = sum(topic == "odometry" for _, topic, _ in recorded["messages"])
    result.write_text(json.dumps(received))
    rclpy.try_shutdown()


if __name__ == "__main__":
    main(Path(sys.argv[1]), float(sys.argv[2]), Path(sys.argv[3]))
