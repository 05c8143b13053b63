# SPDX-License-Identifier: Apache-2.0
"""A vehicle's subscriptions match its peers' publishers in any combination of modes."""

from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="needs ROS")
import rclpy
from node_processes import Witness, running
from rclpy.duration import Duration
from rclpy.qos import (
    HistoryPolicy,
    QoSCompatibility,
    QoSProfile,
    ReliabilityPolicy,
    qos_check_compatible,
)

from uav_vslam.ros.fleet_commands import NodeSpec
from uav_vslam.ros.fusion_node import FusionNode
from uav_vslam.ros.idle_qos import names_of_overrides
from uav_vslam.ros.ins_propagator_node import InsPropagatorNode
from uav_vslam.ros.mapper_node import MapperNode
from uav_vslam.ros.qos import RADIO, compatible_qos
from uav_vslam.ros.slam_backend_node import SlamBackendNode
from uav_vslam.ros.stereo_frontend_node import StereoFrontendNode

pytestmark = pytest.mark.ros
MODES = sorted(RADIO)
NARROW = RADIO["narrowband"]


@pytest.mark.parametrize("own", MODES)
@pytest.mark.parametrize("peer", MODES)
def test_packets_pass_in_any_combination_of_modes(own: str, peer: str) -> None:
    asked = compatible_qos(RADIO[own], [RADIO[peer]])
    found, reason = qos_check_compatible(RADIO[peer], asked)
    assert found != QoSCompatibility.ERROR, reason
    assert qos_check_compatible(RADIO[peer], RADIO[own])[0] == QoSCompatibility.ERROR or own == peer


@pytest.mark.parametrize("mode", MODES)
def test_in_the_same_mode_the_whole_profile_is_requested(mode: str) -> None:
    assert compatible_qos(RADIO[mode], [RADIO[mode]]) == RADIO[mode]
    assert compatible_qos(RADIO[mode], []) == RADIO[mode]


def test_an_offer_without_deadline_satisfies_no_requested_deadline() -> None:
    infinite = QoSProfile(depth=1, deadline=Duration(seconds=9223372036, nanoseconds=854775807))
    for offer in (infinite, QoSProfile(depth=1), QoSProfile(depth=1, deadline=Duration(seconds=4))):
        assert compatible_qos(NARROW, [offer]).deadline == Duration()
    assert compatible_qos(NARROW, [QoSProfile(depth=1, deadline=Duration(seconds=2))]).deadline == NARROW.deadline


def test_the_modes_are_those_of_the_design() -> None:
    wide = RADIO["wideband"]
    assert (wide.reliability, wide.history, wide.depth) == (ReliabilityPolicy.RELIABLE, HistoryPolicy.KEEP_LAST, 10)
    assert (NARROW.reliability, NARROW.history, NARROW.depth) == (
        ReliabilityPolicy.BEST_EFFORT,
        HistoryPolicy.KEEP_LAST,
        1,
    )
    assert NARROW.lifespan == Duration(seconds=2)


def test_an_override_that_no_node_has_is_named_but_not_one_of_another_node(domain_id: int, tmp_path: Path) -> None:
    """A parameter file is shared by all nodes."""
    right, wrong = (f"qos_overrides./uav1/fused/{name}.publisher.depth" for name in ("odometry", "odometri"))
    others = [
        "qos_overrides./uav1/ins/odometry.publisher.depth",
        "qos_overrides./uav2/odometry.subscription.depth",
        "qos_overrides./camera/left.subscription.depth",
    ]
    nobodys = ["qos_overrides./uav1/ins/odometry.subscription.depth", "qos_overrides./uav2/left.subscription.depth"]
    given = dict.fromkeys((right, *others, wrong, *nobodys), 5) | {"input.topics.left": "/camera/left"}
    with Witness(domain_id) as witness, running([NodeSpec("fusion", "/uav1", given)], tmp_path, domain_id):
        assert witness.sees(lambda: witness.text("uav1: fusion"))
    (line,) = [line for line in (tmp_path / "fusion.log").read_text().splitlines() if "without effect" in line]
    assert f": {', '.join([wrong, *nobodys])}; did you mean {right}?" in line


def test_the_overrides_that_count_as_known_are_those_that_the_nodes_declare(domain_id: int) -> None:
    declared: set[str] = set()
    for method in ("given", "in_flight"):  # the node that finds the start publishes it
        for make in (StereoFrontendNode, InsPropagatorNode, SlamBackendNode, FusionNode, MapperNode):
            rclpy.init(args=["--ros-args", "-r", "__ns:=/uav1", "-p", f"start.method:={method}"], domain_id=domain_id)
            node = make()
            declared |= {key for key in node.list_parameters([], 0).names if key.startswith("qos_overrides")}
            known = names_of_overrides(node)
            node.destroy_node()
            rclpy.shutdown()
    assert declared == known
