# SPDX-License-Identifier: Apache-2.0
"""A vehicle's subscriptions match its peers' publishers in any combination of modes."""

from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="needs ROS")
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
from uav_vslam.ros.qos import RADIO, compatible_qos

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


def test_an_override_of_a_topic_that_the_node_does_not_have_is_named(domain_id: int, tmp_path: Path) -> None:
    right, wrong = (f"qos_overrides./uav1/fused/{name}.publisher.depth" for name in ("odometry", "odometri"))
    spec = NodeSpec("fusion", "fusion", "/uav1", {right: 5, wrong: 5})
    with Witness(domain_id) as witness, running([spec], tmp_path, domain_id):
        assert witness.sees(lambda: witness.text("uav1: fusion"))
    (line,) = [line for line in (tmp_path / "fusion.log").read_text().splitlines() if "without effect" in line]
    assert f"{wrong}; did you mean {right}?" in line
