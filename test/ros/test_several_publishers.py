# SPDX-License-Identifier: Apache-2.0
"""An input that two nodes publish is an error that names both, and is not used until one is left."""

import itertools
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

rclpy = pytest.importorskip("rclpy", reason="needs ROS")
from geometry_msgs.msg import TwistWithCovariance  # noqa: E402
from lone_node import lone_node  # noqa: E402
from nav_msgs.msg import Odometry  # noqa: E402
from node_processes import Witness, running  # noqa: E402

from uav_vslam.geometry.pose import Pose  # noqa: E402
from uav_vslam.ros.convert import odometry_to_msg  # noqa: E402
from uav_vslam.ros.fleet_commands import NodeSpec  # noqa: E402
from uav_vslam.ros.ins_propagator_node import InsPropagatorNode  # noqa: E402
from uav_vslam.ros.publishers import UNKNOWN, Publishers, nodes_publishing  # noqa: E402
from uav_vslam.ros.qos import NEWEST  # noqa: E402
from uav_vslam.types import NS_PER_S, PoseEstimate  # noqa: E402
from waiting import wait_for  # noqa: E402

pytestmark = pytest.mark.ros

STEP_NS = NS_PER_S // 50
LIE_M = 286.0
FUSION = "uav1: fusion"
FED = "/uav1/odometry"


class BackEnd:
    """Publishes the odometry of uav1, at a place of its own."""

    def __init__(self, domain_id: int, name: str, *, x_m: float) -> None:
        self._context = rclpy.Context()
        self._context.init(domain_id=domain_id)
        self._node = rclpy.create_node(name, namespace="/uav1", context=self._context)
        self._publisher = self._node.create_publisher(Odometry, "odometry", NEWEST)
        self._x_m = x_m

    def publish(self, stamp_ns: int) -> None:
        pose = PoseEstimate(stamp_ns, Pose(np.eye(3), np.array([self._x_m, 0.0, 0.0])), np.eye(6))
        twist = TwistWithCovariance(covariance=np.eye(6).ravel())
        self._publisher.publish(odometry_to_msg(pose, twist, frame_id="uav1/map", child_frame_id="uav1/base_link"))

    def leave(self) -> None:
        self._node.destroy_node()
        self._context.try_shutdown()


class Feed:
    """Publishes at each turn, from each back end in turn, stamps that always increase.

    Attributes:
        fused_x_m: x of each fused pose so far [m].
    """

    def __init__(self, domain_id: int, witness: Witness) -> None:
        self._domain_id, self._stamp_ns = domain_id, STEP_NS
        self.back_ends: dict[str, BackEnd] = {}
        self.fused_x_m: list[float] = []
        witness.node.create_subscription(Odometry, "/uav1/fused/odometry", self._on_fused, 100)

    def join(self, key: str, name: str, *, x_m: float) -> None:
        self.back_ends[key] = BackEnd(self._domain_id, name, x_m=x_m)

    def leave(self, key: str) -> None:
        self.back_ends.pop(key).leave()

    def step(self) -> None:
        for back_end in self.back_ends.values():
            self._stamp_ns += STEP_NS
            back_end.publish(self._stamp_ns)

    @property
    def times_misled(self) -> int:
        """How often a lie was used right after a truth.

        Where messages of the true node are lost, several of the impostor's come in a row, and nothing tells them from
        those of a restarted node until the true one is heard again.
        """
        return sum(lie and not before for before, lie in itertools.pairwise(x_m > LIE_M / 2 for x_m in self.fused_x_m))

    def _on_fused(self, message: Odometry) -> None:
        self.fused_x_m.append(message.pose.pose.position.x)


@pytest.fixture
def witness(domain_id: int) -> Iterator[Witness]:
    with Witness(domain_id) as one:
        yield one


@pytest.fixture
def feed(domain_id: int, witness: Witness) -> Iterator[Feed]:
    one = Feed(domain_id, witness)
    yield one
    for key in list(one.back_ends):
        one.leave(key)


@pytest.mark.slow
def test_while_two_nodes_publish_an_input_it_is_not_used(
    feed: Feed, witness: Witness, domain_id: int, tmp_path: Path
) -> None:
    fusion = NodeSpec("fusion", "/uav1", {"vehicle": "uav1", "fusion.mode": "none"})
    with running([fusion], tmp_path, domain_id):
        feed.join("true", "slam_backend", x_m=0.0)
        assert witness.sees(lambda: len(feed.fused_x_m) > 20, feed.step)
        for times_allowed, impostor in enumerate(("replay", "slam_backend"), start=1):
            feed.join("false", impostor, x_m=LIE_M)
            assert witness.sees(lambda: witness.is_error(FUSION), feed.step)
            both = ", ".join(sorted(["/uav1/slam_backend", f"/uav1/{impostor}"]))
            assert f"2 nodes publish {FED}: {both};" in witness.text(FUSION)
            assert ("it was started twice" in witness.text(FUSION)) == (impostor == "slam_backend")
            assert_unused(feed, witness)
            feed.leave("false")
            count = len(feed.fused_x_m)
            assert witness.sees(
                lambda n=count: len(feed.fused_x_m) > n + 20 and not witness.is_error(FUSION), feed.step
            )
            assert feed.times_misled <= times_allowed
    log = (tmp_path / "fusion.log").read_text()
    assert log.count(f"2 nodes publish {FED}") == 2
    assert log.count(f"one node publishes {FED} again; it is used") == 2


def assert_unused(feed: Feed, witness: Witness) -> None:
    """Hold that nothing is fused of what is published from now on; the diagnostics count it."""

    def refused() -> int:
        return int(witness.value(FUSION, "dropped/several_publishers") or 0)

    first = refused()
    assert witness.sees(lambda: refused() > first, feed.step)
    fused, later = len(feed.fused_x_m), refused() + 30
    assert witness.sees(lambda: refused() >= later, feed.step)
    assert len(feed.fused_x_m) == fused


def test_several_such_inputs_are_named_in_one_order_in_every_run(domain_id: int) -> None:
    with (
        lone_node(InsPropagatorNode, domain_id) as make,
        Witness(domain_id, name="one") as one,
        Witness(domain_id, name="other") as other,
    ):
        ins = make()
        topics = {it.subscription.topic_name: it for it in ins._inputs if not it.shared}
        held = [w.node.create_publisher(it.message_type, t, it.qos) for t, it in topics.items() for w in (one, other)]

        def found(topic: str) -> bool:
            names = nodes_publishing(ins, topic)
            return topics[topic].subscription.get_publisher_count() == 2 and not any(UNKNOWN in name for name in names)

        assert wait_for(lambda: all(map(found, topics)))
        ins.follow_offers()
        assert list(ins.failures) == sorted(topics)
        assert len(held) == 2 * len(topics) > 6


def numbered(*numbers: int, names: int) -> Publishers:
    found = Publishers()
    found.received(1000)
    found.set(["/uav1/slam_backend"] * names)
    for number in numbers:
        found.received(number)
    return found


@given(st.lists(st.integers(1, 40), min_size=1, max_size=4))
def test_processes_that_died_and_were_restarted_are_not_several(lives: list[int]) -> None:
    found = Publishers()
    found.set(["/uav1/slam_backend"])
    for dead, messages in enumerate(lives):
        found.set(["/uav1/slam_backend"] * (1 + dead))  # the leases of the dead go on
        for number in range(1, messages + 1):
            found.received(number)
            assert not found.several
    for left in range(len(lives), 0, -1):
        found.set(["/uav1/slam_backend"] * left)
        assert not found.several


@given(st.lists(st.booleans(), min_size=8, max_size=40).filter(lambda turns: changes(turns) >= 4), st.integers(1, 9))
def test_two_that_publish_in_turns_are_several_whatever_their_order(turns: list[bool], ahead: int) -> None:
    found, numbers = Publishers(), {True: ahead, False: 1}
    found.set(["/uav1/slam_backend"] * 2)
    for who in turns:
        found.received(numbers[who])
        numbers[who] += 1
    assert found.several


def test_two_of_one_name_are_known_by_the_second_message_of_the_later_one() -> None:
    assert not numbered(1, 1001, names=2).several
    assert numbered(1, 1001, 2, names=2).several


def changes(turns: list[bool]) -> int:
    return sum(a != b for a, b in itertools.pairwise(turns))


def test_names_that_are_not_known_yet_accuse_nobody() -> None:
    found = numbered(names=1)
    found.set(["/uav1/slam_backend", "_NODE_NAMESPACE_UNKNOWN_/_NODE_NAME_UNKNOWN_"])
    assert not found.several
    found.set(["/uav1/slam_backend", "/replay"])
    assert found.several


def test_a_middleware_that_numbers_nothing_accuses_nobody() -> None:
    assert not numbered(*[2**64 - 1] * 50, names=2).several
    assert numbered(1, 1001, 2, 1002, names=2).several
