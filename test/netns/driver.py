# SPDX-License-Identifier: Apache-2.0
"""Stands for a vehicle's camera and IMU drivers: a recording with the stamps of now. Notes what the fusion node says.

usage: driver.py BAG VEHICLE NOTES      NOTES: JSON, one line each

When all four nodes have reported, it reads the wall time of its first message [s] from its standard input.
"""

import json
import struct
import sys
import time
from pathlib import Path
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray

from uav_vslam.ros.fleet_commands import VEHICLE_NODES
from uav_vslam.ros.qos import IMAGE, LATCHED, SENSOR, STATE
from uav_vslam.ros.recorded import Kind
from uav_vslam.ros.recording import Recording
from uav_vslam.types import NS_PER_S
from uav_vslam_msgs.msg import FusionStatus

QOS = {Kind.LEFT: IMAGE, Kind.RIGHT: IMAGE, Kind.IMU: SENSOR}


def restamped(data: bytes, by_ns: int) -> bytes:
    """Move the stamp of a serialised message that begins with a header."""
    sec, nanosec = struct.unpack_from("<iI", data, 4)
    moved = bytearray(data)
    struct.pack_into("<iI", moved, 4, *divmod(sec * NS_PER_S + nanosec + by_ns, NS_PER_S))
    return bytes(moved)


def main(bag: Path, vehicle: str, notes: Path) -> None:
    """Play, listen, and end with the recording or a signal."""
    recording = Recording([bag], [vehicle])
    rclpy.init()
    node = rclpy.create_node("driver", namespace=f"/{vehicle}")
    latched = {raw.topic for raw in recording.latched}
    heard: set[str] = set()
    with notes.open("w", buffering=1) as file:

        def on_status(status: FusionStatus) -> None:
            used = {peer.peer: peer.packets_used for peer in status.peers}
            print(json.dumps({"mode": status.mode, "used": used}), file=file)

        def on_diagnostics(message: DiagnosticArray) -> None:
            for status in message.status:
                heard.add(status.name)
                print(json.dumps({"name": status.name, "text": status.message}), file=file)

        node.create_subscription(FusionStatus, "fusion/status", on_status, STATE)
        node.create_subscription(DiagnosticArray, "/diagnostics", on_diagnostics, 10)
        while not heard >= {f"{vehicle}: {name}" for name in VEHICLE_NODES}:
            rclpy.spin_once(node)
        print(json.dumps({"ready": True}), file=file)
        play(node, recording, latched, float(sys.stdin.readline()))
    rclpy.try_shutdown()


def play(node: Any, recording: Recording, latched: set[str], start_s: float) -> None:
    """Publish everything at its time, moved so that the recording begins at `start_s`."""
    types = {topic: message_type(info.msgtype) for topic, info in recording.topics.items()}
    profiles = {topic: LATCHED if topic in latched else QOS.get(recording.classify(topic)[1], STATE) for topic in types}
    publishers = {topic: node.create_publisher(kind, topic, profiles[topic]) for topic, kind in types.items()}
    first_ns = min(recording.starts_ns.values())
    by_ns = round(start_s * NS_PER_S) - first_ns
    for raw in recording.latched:
        publishers[raw.topic].publish(raw.data if raw.topic == "/tf_static" else restamped(raw.data, by_ns))
    for message in recording.messages():
        due_s = (message.stamp_ns + by_ns) / NS_PER_S
        rclpy.spin_once(node, timeout_sec=0.0)
        while time.time() < due_s:
            rclpy.spin_once(node, timeout_sec=max(due_s - time.time(), 0.0))
        publishers[message.topic].publish(restamped(message.payload, by_ns))


def message_type(name: str) -> Any:
    """Return the class of "sensor_msgs/msg/Imu"."""
    from importlib import import_module

    package, _, kind = name.split("/")
    return getattr(import_module(f"{package}.msg"), kind)


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2], Path(sys.argv[3]))
