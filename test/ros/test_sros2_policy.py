# SPDX-License-Identifier: Apache-2.0
"""The SROS2 template allows each node what it does, and nothing that no node does."""

import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

rclpy = pytest.importorskip("rclpy", reason="needs ROS")
from uav_vslam.ros.fusion_node import FusionNode  # noqa: E402
from uav_vslam.ros.ins_propagator_node import InsPropagatorNode  # noqa: E402
from uav_vslam.ros.slam_backend_node import SlamBackendNode  # noqa: E402
from uav_vslam.ros.stereo_frontend_node import StereoFrontendNode  # noqa: E402

pytestmark = pytest.mark.ros

TEMPLATE = Path(__file__).parents[2] / "config" / "sros2" / "vehicle.policy.xml"
NODES = {
    "stereo_frontend": StereoFrontendNode,
    "ins_propagator": InsPropagatorNode,
    "slam_backend": SlamBackendNode,
    "fusion": FusionNode,
}
OF_EVERY_NODE = {"/rosout", "/parameter_events"}  # in the file that the template includes
OPTIONAL_PUBLICATIONS = {"/uav1/initial_state"}  # with start.method static or in_flight
ON_DEMAND = {"/clock"}  # with use_sim_time


PARAMETERS = ("parameter", "get_type_description")  # in names of services of every node, likewise included


def allowed(node: str, what: str, kind: str = "topic") -> set[str]:
    text = TEMPLATE.read_text(encoding="utf-8").replace("@VEHICLE@", "uav1").replace("@PEER@", "uav2")
    found = ET.fromstring(text).findall(f".//profile[@node='{node}']/{kind}s[@{what}='ALLOW']/{kind}")
    return {t.text if str(t.text).startswith("/") else f"/uav1/{t.text}" for t in found}


@pytest.mark.parametrize("name", NODES)
def test_a_node_is_allowed_just_what_it_does(name: str, domain_id: int) -> None:
    settings = ["-p", "peers:=[uav2]", "-p", "fusion.feedback:=true"]  # so that every optional topic is open
    rclpy.init(args=["--ros-args", "-r", "__ns:=/uav1", *settings], domain_id=domain_id)
    node = NODES[name]()
    try:
        published = {p.topic_name for p in node.publishers} - OF_EVERY_NODE
        subscribed = {s.topic_name for s in node.subscriptions} - OF_EVERY_NODE
        served = {node.resolve_service_name(s.srv_name) for s in node.services}
    finally:
        node.destroy_node()
        rclpy.shutdown()
    assert published <= allowed(name, "publish")
    assert allowed(name, "publish") - published <= OPTIONAL_PUBLICATIONS | {f"/uav1/{name}/transition_event"}
    assert {s for s in served if not any(word in s for word in PARAMETERS)} == allowed(name, "reply", "service")
    assert subscribed - ON_DEMAND <= allowed(name, "subscribe")
    compressed = {t for t in allowed(name, "subscribe") if t.endswith("/compressed")}
    assert allowed(name, "subscribe") - subscribed <= ON_DEMAND | compressed
