# SPDX-License-Identifier: Apache-2.0
"""What is published over DDS arrives in the monitored state, whatever QoS is offered, and strangers stay out."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import pytest

rclpy = pytest.importorskip("rclpy", reason="needs ROS")
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue  # noqa: E402
from nav_msgs.msg import Odometry  # noqa: E402
from rclpy.node import Node  # noqa: E402
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy  # noqa: E402
from sensor_msgs.msg import Imu  # noqa: E402

from uav_vslam.monitor import WARN, Fleet  # noqa: E402
from uav_vslam.ros.fleet_monitor import GraphListener  # noqa: E402
from uav_vslam.ros.topic_tools import observer  # noqa: E402
from uav_vslam_msgs.msg import FrameQuality, FusionStatus, PeerLink, StereoFeatures  # noqa: E402
from waiting import wait_for  # noqa: E402

pytestmark = pytest.mark.ros

OFFERS = {
    "best effort": QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT),
    "latched": QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL),
}
COVARIANCE = [0.0] * 36
COVARIANCE[0], COVARIANCE[7], COVARIANCE[14], COVARIANCE[35] = 4.0, 4.0, 1.0, 0.01


def odometry() -> Odometry:
    message = Odometry()
    message.pose.covariance = COVARIANCE
    return message


def status() -> FusionStatus:
    peer = PeerLink(
        peer="uav9",
        packets_received=9,
        packets_used=8,
        drop_reasons=["late"],
        drop_counts=[1],
        received_bytes_per_s=120.0,
        common_landmarks=7,
        age_s=1.5,
        silent=True,
    )
    return FusionStatus(mode="narrowband", recent_bytes_per_s=250.0, peers=[peer])


def diagnostics(vehicle: str, node: str) -> DiagnosticArray:
    values = [KeyValue(key="dropped/late", value="4")]
    name = f"{vehicle}: {node}"
    one = DiagnosticStatus(level=b"\x01", name=name, message="slow", hardware_id=vehicle, values=values)
    return DiagnosticArray(status=[one])


MESSAGES: dict[str, Callable[[], Any]] = {
    "stereo_features": StereoFeatures,
    "ins/odometry": Odometry,
    "odometry": odometry,
    "fused/odometry": odometry,
    "slam/quality": lambda: FrameQuality(landmarks=77, coasted=True),
    "fusion/status": status,
    "/camera_driver/imu": Imu,
}


@contextmanager
def vehicle_node(domain_id: int, namespace: str, qos: QoSProfile) -> Iterator[Callable[[], None]]:
    """Open a node that has a vehicle's outputs and its IMU input; yield what publishes one message of each."""
    context = rclpy.Context()
    context.init(domain_id=domain_id)
    node = Node("ins_propagator", namespace=namespace, context=context)
    node.create_subscription(Imu, "/camera_driver/imu", lambda _: None, qos)
    publishers = {topic: node.create_publisher(type(make()), topic, qos) for topic, make in MESSAGES.items()}
    health = node.create_publisher(DiagnosticArray, "/diagnostics", 10)
    vehicle = namespace.strip("/").replace("/", "_")

    def publish() -> None:
        for topic, publisher in publishers.items():
            publisher.publish(MESSAGES[topic]())
        health.publish(diagnostics(vehicle, "slam_backend"))

    try:
        yield publish
    finally:
        node.destroy_node()
        context.try_shutdown()


@pytest.mark.parametrize("offer", OFFERS)
def test_everything_published_reaches_the_state(offer: str, domain_id: int) -> None:
    fleet = Fleet()
    with vehicle_node(domain_id, "/team/uav1", OFFERS[offer]) as publish, observer(domain_id) as node:
        listener = GraphListener(node, fleet)

        def turn() -> None:
            publish()
            listener.spin(0.05)

        def complete() -> bool:
            vehicle = fleet.vehicles.get("team_uav1")
            streams = vehicle.streams.values() if vehicle else []
            known = vehicle and vehicle.own and vehicle.fused and vehicle.link and vehicle.frames and vehicle.nodes
            return bool(known and all(stream.age_s(0.0) is not None for stream in streams))

        assert wait_for(complete, turn)
    (vehicle,) = fleet.vehicles.values()
    assert vehicle.own is not None
    assert vehicle.fused is not None
    assert (vehicle.own.sigma_m, vehicle.fused.sigma_heading_rad) == (3.0, pytest.approx(0.1))
    assert (vehicle.landmarks, vehicle.frames, vehicle.coasted) == (77, vehicle.coasted, vehicle.frames)
    assert vehicle.link is not None
    assert (vehicle.mode, vehicle.link.sent_bytes_per_s, vehicle.link.wire_sent_bytes_per_s) == (
        "narrowband",
        250.0,
        None,
    )
    (peer,) = vehicle.link.peers
    assert (peer.name, peer.packets_received, peer.packets_used, peer.received_bytes_per_s) == ("uav9", 9, 8, 120.0)
    assert (peer.packets_dropped, peer.common_landmarks, peer.age_s, peer.silent) == (1, 7, 1.5, True)
    report = vehicle.nodes["slam_backend"]
    assert (report.level, report.text, vehicle.dropped) == (WARN, "slow", {"late": 4})


def test_vehicles_that_are_not_asked_for_are_not_listened_to(domain_id: int) -> None:
    fleet = Fleet(["uav2"])
    qos = QoSProfile(depth=10)
    with (
        vehicle_node(domain_id, "/uav1", qos) as first,
        vehicle_node(domain_id, "/uav2", qos) as second,
        observer(domain_id) as node,
    ):
        listener = GraphListener(node, fleet)

        def turn() -> None:
            first()
            second()
            listener.spin(0.05)

        assert wait_for(lambda: fleet.vehicles["uav2"].own and fleet.vehicles["uav2"].nodes, turn)
        topics = {one.topic_name for one in node.subscriptions}
    assert list(fleet.vehicles) == ["uav2"]
    assert "/uav2/odometry" in topics
    assert not any(topic.startswith("/uav1/") for topic in topics)


def test_other_diagnostics_are_no_vehicles(domain_id: int) -> None:
    fleet = Fleet()
    with observer(domain_id) as node:
        listener = GraphListener(node, fleet)
        driver = DiagnosticStatus(name="camera: temperature", hardware_id="serial 7")
        listener._on_diagnostics(DiagnosticArray(status=[driver, DiagnosticStatus(name="link_emulator: link")]))
        assert fleet.vehicles == {}
        listener._on_diagnostics(diagnostics("uav1", "fusion"))
        assert list(fleet.vehicles) == ["uav1"]
