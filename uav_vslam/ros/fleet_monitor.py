# SPDX-License-Identifier: Apache-2.0
"""Listens to a running node graph and keeps a `monitor.Fleet` up to date; for `uav-vslam monitor`.

in   /diagnostics                         diagnostic_msgs/DiagnosticArray of every node
     <ns>/odometry, <ns>/fused/odometry   nav_msgs/Odometry
     <ns>/slam/quality                    uav_vslam_msgs/FrameQuality
     <ns>/fusion/status                   uav_vslam_msgs/FusionStatus
     <ns>/stereo_features, <ns>/ins/odometry, and the IMU's topic    only counted

Every subscription is best effort: a monitor on a slow terminal must not make a vehicle repeat messages. Images are left
alone, their features' rate is theirs. Namespaces are those with one of these topics.
"""

import time
from collections.abc import Callable
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from nav_msgs.msg import Odometry
from rclpy.node import NodeNameNonExistentError
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import Imu

from uav_vslam.monitor import Claim, Fleet, Link, NodeReport, Peer, Vehicle
from uav_vslam.ros.fleet_commands import vehicle_in
from uav_vslam.ros.topic_tools import Observer
from uav_vslam_msgs.msg import FrameQuality, FusionStatus, StereoFeatures

DISCOVERY_S = 1.0
QOS = QoSProfile(depth=200, reliability=ReliabilityPolicy.BEST_EFFORT)
IMU_TYPE = "sensor_msgs/msg/Imu"
INS_NODE = "ins_propagator"  # whose subscription gives the name of the IMU's topic
OWN_TYPES = {  # topics by which a vehicle's namespace is known: other robots have an odometry too
    "stereo_features": "uav_vslam_msgs/msg/StereoFeatures",
    "slam/quality": "uav_vslam_msgs/msg/FrameQuality",
    "fusion/status": "uav_vslam_msgs/msg/FusionStatus",
}


class GraphListener:
    """The subscriptions; they grow with the graph."""

    def __init__(self, node: Observer, fleet: Fleet) -> None:
        """Listen by `node`; `fleet` decides which vehicles count."""
        self._node, self._fleet = node, fleet
        self._topics: set[str] = set()
        self._namespaces: dict[str, str] = {}  # of the vehicles, by name
        self._next_s = 0.0
        node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, QOS)

    def spin(self, duration_s: float) -> None:
        """Listen for so long [s]."""
        end_s = time.monotonic() + duration_s
        while (now_s := time.monotonic()) < end_s:
            if now_s >= self._next_s:
                self._next_s = now_s + DISCOVERY_S
                self._discover()
            self._node.spin_until(lambda: False, min(end_s, self._next_s) - now_s)

    def _discover(self) -> None:
        """Subscribe to what has appeared."""
        for topic, types in self._node.get_topic_names_and_types():
            for name, kind in OWN_TYPES.items():
                if kind in types and topic.endswith(f"/{name}"):
                    self._add(topic.removesuffix(f"/{name}"))
        for name, namespace in self._namespaces.items():
            self._find_imu(name, namespace)

    def _add(self, namespace: str) -> None:
        name = vehicle_in(namespace)
        vehicle = self._fleet.vehicle(name)
        if vehicle is None or name in self._namespaces:
            return
        self._namespaces[name] = namespace
        self._count(vehicle, "features", StereoFeatures, f"{namespace}/stereo_features")
        self._count(vehicle, "ins", Odometry, f"{namespace}/ins/odometry")
        self._listen(Odometry, f"{namespace}/odometry", lambda m: _on_own(vehicle, m))
        self._listen(Odometry, f"{namespace}/fused/odometry", lambda m: _on_fused(vehicle, m))
        self._listen(FrameQuality, f"{namespace}/slam/quality", lambda m: _on_quality(vehicle, m))
        self._listen(FusionStatus, f"{namespace}/fusion/status", lambda m: _on_status(vehicle, m))

    def _find_imu(self, name: str, namespace: str) -> None:
        """Count the readings that the vehicle's INS subscribes to."""
        vehicle = self._fleet.vehicles[name]
        try:
            topics = self._node.get_subscriber_names_and_types_by_node(INS_NODE, namespace or "/")
        except NodeNameNonExistentError:
            return
        for topic, types in topics:
            if IMU_TYPE in types:
                self._count(vehicle, "imu", Imu, topic)

    def _count(self, vehicle: Vehicle, stream: str, kind: Any, topic: str) -> None:
        self._listen(kind, topic, lambda _: vehicle.streams[stream].arrived(time.monotonic()), raw=True)

    def _listen(self, kind: Any, topic: str, callback: Callable[[Any], None], *, raw: bool = False) -> None:
        if topic not in self._topics:
            self._topics.add(topic)
            self._node.create_subscription(kind, topic, callback, QOS, raw=raw)

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            owner, _, node = status.name.partition(": ")
            if status.hardware_id and owner == status.hardware_id and (vehicle := self._fleet.vehicle(owner)):
                vehicle.nodes[node] = _report(status)


def _report(status: DiagnosticStatus) -> NodeReport:
    values = {entry.key: entry.value for entry in status.values}
    return NodeReport(int.from_bytes(status.level, "little"), status.message, values, time.monotonic())


def _on_own(vehicle: Vehicle, message: Odometry) -> None:
    vehicle.streams["odometry"].arrived(time.monotonic())
    vehicle.own = Claim.of(message.pose.covariance)


def _on_fused(vehicle: Vehicle, message: Odometry) -> None:
    vehicle.streams["fused"].arrived(time.monotonic())
    vehicle.fused = Claim.of(message.pose.covariance)


def _on_quality(vehicle: Vehicle, message: FrameQuality) -> None:
    vehicle.on_frame(landmarks=message.landmarks, coasted=message.coasted)


def _on_status(vehicle: Vehicle, message: FusionStatus) -> None:
    peers = tuple(
        Peer(
            name=link.peer,
            packets_received=link.packets_received,
            packets_used=link.packets_used,
            packets_dropped=sum(link.drop_counts),
            received_bytes_per_s=link.received_bytes_per_s,
            common_landmarks=link.common_landmarks,
            age_s=link.age_s,
            silent=link.silent,
        )
        for link in message.peers
    )
    wire = message.wire_sent_bytes_per_s if message.radio_interface else None
    vehicle.link = Link(message.mode, message.recent_bytes_per_s, wire, peers)
