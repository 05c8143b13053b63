# SPDX-License-Identifier: Apache-2.0
"""The fusion node on its radio: modes that change in flight, a hard budget, peers that come late or become silent."""

import dataclasses
import itertools
import os
import socket
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

rclpy = pytest.importorskip("rclpy", reason="needs ROS")
from geometry_msgs.msg import TwistWithCovariance  # noqa: E402
from nav_msgs.msg import Odometry  # noqa: E402
from rclpy.executors import SingleThreadedExecutor  # noqa: E402
from rclpy.parameter import Parameter  # noqa: E402
from rclpy.qos import QoSProfile, ReliabilityPolicy  # noqa: E402
from rclpy.serialization import serialize_message  # noqa: E402
from std_msgs.msg import String  # noqa: E402
from tf2_msgs.msg import TFMessage  # noqa: E402

from uav_vslam.config import FusionConfig  # noqa: E402
from uav_vslam.cooperation.fusion import Fusion  # noqa: E402
from uav_vslam.errors import ConfigError, FilterDivergence  # noqa: E402
from uav_vslam.ros.convert import joint_to_msg, odometry_to_msg  # noqa: E402
from uav_vslam.ros.fusion_node import FusionNode  # noqa: E402
from uav_vslam.ros.packet_message import packet_to_msg  # noqa: E402
from uav_vslam.ros.qos import LATCHED, NEWEST, RADIO, STATE  # noqa: E402
from uav_vslam.types import NS_PER_S, JointInformation, PoseEstimate  # noqa: E402
from uav_vslam_msgs.msg import FusionStatus, LandmarkInformation, NavigationState  # noqa: E402
from uav_vslam_msgs.msg import JointInformation as JointInformationMsg  # noqa: E402
from waiting import wait_for  # noqa: E402

pytestmark = pytest.mark.ros

QUIET_TURNS = 35  # enough for what should not come
PACKETS = "/uav1/landmark_information"


class Flight:
    """A fusion node of uav1, spun here, with its back end and its peer uav2 played by a second node."""

    def __init__(
        self, make_joint: Callable[..., JointInformation], domain_id: int, *parameters: str, peers: str = "[uav2]"
    ) -> None:
        arguments = ["--ros-args", "-r", "__ns:=/uav1", "-p", f"peers:={peers}"]
        for parameter in parameters:
            arguments += ["-p", parameter]
        rclpy.init(args=arguments, domain_id=domain_id)
        self._make_joint = make_joint
        self._peer = Fusion("uav2", FusionConfig())
        self.executor = SingleThreadedExecutor()
        self.node = FusionNode(arguments)
        self.others = rclpy.create_node("others", use_global_arguments=False)
        self.executor.add_node(self.node)
        self.executor.add_node(self.others)
        self.session = 1
        self.status: list[FusionStatus] = []
        self.received: list[LandmarkInformation] = []
        status = self.others.create_subscription(FusionStatus, "/uav1/fusion/status", self.status.append, STATE)
        self._joints = self.others.create_publisher(JointInformationMsg, "/uav1/joint_information", NEWEST)
        self._odometry = self.others.create_publisher(Odometry, "/uav1/odometry", NEWEST)
        assert self.spin(lambda: self._odometry.get_subscription_count() and self._joints.get_subscription_count())
        assert self.spin(lambda: status.get_publisher_count() and self.node._status.get_subscription_count())
        self._move(NS_PER_S // 2)  # a frame before the first epoch

    def turn(self) -> None:
        self.executor.spin_once(timeout_sec=0.02)

    def spin(self, until: Callable[[], Any]) -> bool:
        return wait_for(until, self.turn)

    def rest(self) -> None:
        for _ in range(QUIET_TURNS):
            self.turn()

    def listen(self, mode: str, node: Any = None) -> None:
        """Subscribe to uav1 as a peer in that mode does, and wait until both sides have discovered each other."""
        sender = self.node._radio._publisher
        before = sender.get_subscription_count()
        node = node or self.others
        made = node.create_subscription(LandmarkInformation, PACKETS, self.received.append, RADIO[mode])
        assert self.spin(lambda: made.get_publisher_count() > 0 and sender.get_subscription_count() > before)

    def joint(self, second: int, vehicle: str) -> JointInformation:
        points = [[4.0 * k, 7.0 * (k % 3), 0.0] for k in range(6)]
        return self._make_joint(points, np.eye(24), vehicle=vehicle, session=self.session, stamp_ns=second * NS_PER_S)

    def epoch(self, second: int) -> FusionStatus:
        """Feed the frame of an epoch and return the status that it brings."""
        joint, count = self.joint(second, "uav1"), len(self.status)
        self._joints.publish(joint_to_msg(joint, frame_id="uav1/map"))
        self._move(joint.stamp_ns)
        assert self.spin(lambda: len(self.status) > count)
        return self.status[-1]

    def _move(self, stamp_ns: int) -> None:
        pose = PoseEstimate(stamp_ns, self.joint(1, "uav1").T_map_body, np.eye(6))
        twist = TwistWithCovariance(covariance=np.eye(6).ravel())
        twist.twist.linear.x = 20.0
        self._odometry.publish(odometry_to_msg(pose, twist, frame_id="uav1/map", child_frame_id="uav1/base_link"))

    def peer(self, mode: str) -> Any:
        """Return uav2's publisher in that mode, once uav1 is matched."""
        publisher = self.others.create_publisher(LandmarkInformation, "/uav2/landmark_information", RADIO[mode])
        assert self.spin(lambda: publisher.get_subscription_count() > 0)
        return publisher

    def packet(self, second: int, *, of: str = "uav2") -> LandmarkInformation:
        fusion = self._peer if of == "uav2" else Fusion(of, FusionConfig())
        fusion.fuse(self.joint(second, of))
        return packet_to_msg(fusion.packet())

    def newest_ns(self) -> int:
        """Stamp of the newest packet that uav1 has of uav2, 0 for none."""
        packet = self.node._fusion.inbox.newest("uav2", 10**18)
        return packet.stamp_ns if packet else 0

    def set(self, name: str, value: Any) -> Any:
        (result,) = self.node.set_parameters([Parameter(name, value=value)])
        return result

    def offered(self) -> list[ReliabilityPolicy]:
        return [i.qos_profile.reliability for i in self.others.get_publishers_info_by_topic(PACKETS)]

    def close(self) -> None:
        self.executor.shutdown()
        self.node.destroy_node()
        self.others.destroy_node()
        rclpy.try_shutdown()


@pytest.fixture
def fly(make_joint: Callable[..., JointInformation], domain_id: int) -> Iterator[Callable[..., Flight]]:
    made: list[Flight] = []

    def start(*parameters: str, peers: str = "[uav2]") -> Flight:
        made.append(Flight(make_joint, domain_id, *parameters, peers=peers))
        return made[-1]

    yield start
    for one in made:
        one.close()
    rclpy.try_shutdown()


def test_the_mode_is_switched_in_flight_and_estimates_go_on(fly: Callable[..., Flight]) -> None:
    flight = fly()
    assert flight.spin(lambda: flight.offered() == [ReliabilityPolicy.RELIABLE])
    assert flight.epoch(1).mode == "wideband"
    assert flight.set("fusion.mode", "narrowband").successful
    assert flight.spin(lambda: flight.offered() == [ReliabilityPolicy.BEST_EFFORT])
    assert flight.epoch(2).mode == "narrowband"
    assert flight.epoch(3).packets_sent == 2  # two epochs save for a narrowband packet
    assert flight.set("fusion.mode", "none").successful
    assert flight.spin(lambda: flight.offered() == [])
    status = flight.epoch(4)
    assert (status.mode, status.packets_sent) == ("none", 2)
    assert flight.set("fusion.mode", "wideband").successful
    assert flight.spin(lambda: flight.offered() == [ReliabilityPolicy.RELIABLE])
    assert flight.epoch(5).packets_sent == 3


def test_frames_of_the_session_before_that_wait_still_do_not_keep_out_those_of_a_clock_that_was_set_back(
    fly: Callable[..., Flight],
) -> None:
    flight = fly()
    flight.epoch(20)
    flight._move(20 * NS_PER_S + NS_PER_S // 7)
    flight._move(20 * NS_PER_S + 2 * NS_PER_S // 7)
    flight.session = 2
    flight._joints.publish(joint_to_msg(flight.joint(1, "uav1"), frame_id="uav1/map"))
    flight._move(NS_PER_S)  # the first frame of a session brings no status
    assert flight.epoch(2).header.stamp.sec == 2
    assert flight.node.counts.total() == 0


def test_a_mode_that_there_is_not_is_refused(fly: Callable[..., Flight]) -> None:
    flight = fly()
    result = flight.set("fusion.mode", "radio")
    assert not result.successful
    assert "fusion.mode = 'radio' is not allowed; use one of wideband, narrowband, none" in result.reason
    assert flight.epoch(1).mode == "wideband"


def test_a_mode_that_does_not_go_with_the_extractor_is_refused(fly: Callable[..., Flight]) -> None:
    flight = fly("frontend.extractor:=surf")
    result = flight.set("fusion.mode", "narrowband")
    assert not result.successful
    assert "in narrowband mode, whose descriptors are made of SIFT's" in result.reason
    assert flight.epoch(1).mode == "wideband"


def test_an_epoch_that_fails_leaves_the_vehicle_its_pose(
    fly: Callable[..., Flight], monkeypatch: pytest.MonkeyPatch
) -> None:
    flight, poses = fly(), []
    flight.others.create_subscription(Odometry, "/uav1/fused/odometry", poses.append, STATE)
    assert flight.spin(lambda: flight.node._odometry.get_subscription_count() > 0)
    flight.epoch(1)
    fuse = flight.node._fusion.fuse

    def fail(_: JointInformation) -> None:
        monkeypatch.setattr(flight.node._fusion, "fuse", fuse)
        raise FilterDivergence("joint information is not positive definite")

    monkeypatch.setattr(flight.node._fusion, "fuse", fail)
    flight._joints.publish(joint_to_msg(flight.joint(2, "uav1"), frame_id="uav1/map"))
    flight._move(2 * NS_PER_S)
    assert flight.spin(lambda: poses and poses[-1].header.stamp.sec == 2)
    assert flight.node.counts["dropped/refused"] == 1
    assert flight.epoch(3).header.stamp.sec == 3


@pytest.mark.parametrize(
    ("parameter", "message"),
    [
        ("fusion.mode:=radio", "mode = 'radio' is not allowed; use one of wideband, narrowband, none"),
        ("radio_domain_id:={own}", "radio_domain_id = {own} is the vehicle's own ROS domain"),
        ("radio_peers:=['10.0.0.1']", "set radio_domain_id as well"),
        ("radio_domain_id:={other} radio_peers:=['no.address']", "resolve peer no.address; use addresses, like"),
    ],
)
def test_a_wrong_parameter_ends_the_node_at_its_start(
    domain_id: int, make_domain_id: Callable[[], int], parameter: str, message: str
) -> None:
    words = parameter.format(own=domain_id, other=make_domain_id()).split()
    given = ["--ros-args", "-r", "__ns:=/uav1", *(part for word in words for part in ("-p", word))]
    rclpy.init(args=given, domain_id=domain_id)
    try:
        with pytest.raises(ConfigError, match=message.format(own=domain_id)):
            FusionNode(given)
    finally:
        rclpy.try_shutdown()


@pytest.mark.parametrize(("parameter", "name"), [("use_sim_time:=false", "fleet_drone"), ("vehicle:=uav1", "uav1")])
def test_packets_are_sent_under_the_name_by_which_peers_know_a_vehicle(
    domain_id: int, parameter: str, name: str
) -> None:
    given = ["--ros-args", "-r", "__ns:=/fleet/drone", "-p", "peers:=[uav2]", "-p", "fusion.feedback:=true"]
    given += ["-p", parameter]
    rclpy.init(args=given, domain_id=domain_id)
    try:
        node = FusionNode(given)
        own = (node.get_name(), node.get_namespace())
        sent = {topic for topic, _ in node.get_publisher_names_and_types_by_node(*own)}
        heard = {topic for topic, _ in node.get_subscriber_names_and_types_by_node(*own)}
        node.destroy_node()
    finally:
        rclpy.try_shutdown()
    radio = ("landmark_information", "fusion/feedback")
    assert {topic for topic in sent if topic.endswith(radio)} == {
        f"/{name}/landmark_information",
        "/uav2/fusion/feedback",
    }
    assert {topic for topic in heard if topic.endswith(radio)} == {
        "/uav2/landmark_information",
        f"/{name}/fusion/feedback",
    }


@pytest.mark.parametrize(
    ("peers", "said"), [("[uav1, uav2, uav3]", "uav2, uav3\n"), ("[uav1]", "none (the parameter peers names them)\n")]
)
def test_the_log_says_with_whom_a_vehicle_cooperates(
    fly: Callable[..., Flight], capfd: pytest.CaptureFixture[str], peers: str, said: str
) -> None:
    fly(peers=peers)
    assert f"communication mode: wideband, peers: {said}" in capfd.readouterr().err


def test_a_peer_that_comes_late_has_a_packet_after_one_epoch(fly: Callable[..., Flight]) -> None:
    flight = fly()
    for second in (1, 2, 3):
        flight.epoch(second)
    flight.listen("wideband")
    flight.rest()
    assert flight.received == []
    flight.epoch(4)
    assert flight.spin(lambda: flight.received)
    assert flight.received[0].sequence == 4
    assert len(flight.received[0].ids) == 6


def test_narrowband_without_peers_leaves_the_radio_to_discovery(fly: Callable[..., Flight]) -> None:
    flight = fly("fusion.mode:=narrowband", "fusion.silent_after_s:=2.0")
    publisher = flight.peer("narrowband")
    sent = [flight.epoch(second).packets_sent for second in range(11, 18)]
    assert sent == [0, 1, 2, 3, 4, 4, 4]  # the first is saved for
    publisher.publish(flight.packet(17))
    assert flight.spin(lambda: flight.newest_ns() == 17 * NS_PER_S)
    sent = [flight.epoch(second).packets_sent for second in range(18, 26)]
    assert sent == [5, 6, 7, 8, 9, 10, 11, 11]  # 17 is too old from 20 on


def test_what_the_budget_has_no_room_for_is_counted_and_never_sent(fly: Callable[..., Flight]) -> None:
    flight = fly("fusion.budget_bytes_per_s:=1")
    flight.listen("wideband")
    flight.epoch(1)
    status = flight.epoch(2)
    flight.rest()
    assert (status.packets_sent, status.packets_held_back, status.bytes_sent) == (0, 2, 0)
    assert flight.node.counts["dropped/budget"] == 2
    assert flight.received == []


def test_the_status_counts_the_bytes_that_were_sent_and_received(fly: Callable[..., Flight]) -> None:
    flight = fly("radio_interface:=lo", "fusion.feedback:=false")
    flight.listen("wideband")
    publisher = flight.peer("wideband")
    for second in (1, 2, 3):
        publisher.publish(flight.packet(second))
        assert flight.spin(lambda ns=second * NS_PER_S: flight.newest_ns() == ns)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as program:  # DDS itself may use shared memory
            program.sendto(bytes(1000), ("127.0.0.1", 9))
        status = flight.epoch(second)
    assert flight.spin(lambda: len(flight.received) == 3)
    sizes = [len(serialize_message(message)) for message in flight.received]
    assert status.bytes_sent == sum(sizes)
    assert status.recent_bytes_per_s == pytest.approx(np.mean(sizes[1:]))
    (link,) = status.peers
    assert link.received_bytes == 3 * len(serialize_message(flight.packet(9)))
    assert link.received_bytes_per_s > 0
    assert status.radio_interface == "lo"
    assert status.wire_sent_bytes > 3 * 1000
    assert status.wire_received_bytes > 3 * 1000


def test_a_silent_peer_is_reported_until_it_is_received_again(fly: Callable[..., Flight]) -> None:
    flight = fly("fusion.silent_after_s:=3.0")
    publisher = flight.peer("wideband")
    for second, expected in ((21, False), (23, False), (25, True), (26, False)):
        if second in (21, 26):
            publisher.publish(flight.packet(second - 20))  # by another clock
            newest = (second - 20) * NS_PER_S
            assert flight.spin(lambda ns=newest: flight.newest_ns() == ns)
        (link,) = flight.epoch(second).peers
        assert link.silent is expected, second
        assert ("uav2" in flight.node.alarms) is expected


def test_a_peer_whose_landmarks_contradict_the_own_estimate_is_reported_until_they_fit(
    fly: Callable[..., Flight],
) -> None:
    """Without a gate, landmarks that are known to a metre are paired with some 20 m away."""
    flight = fly("fusion.association:=nn")
    publisher, peer = flight.peer("wideband"), Fusion("uav2", FusionConfig())
    for second, off_m in ((1, 20.0), (2, 0.0)):
        joint = flight.joint(second, "uav2")
        peer.fuse(dataclasses.replace(joint, positions=joint.positions + np.array([off_m, 0.0, 0.0])))
        publisher.publish(packet_to_msg(peer.packet()))
        assert flight.spin(lambda ns=joint.stamp_ns: flight.newest_ns() == ns)
        flight.epoch(second + 1)
        assert ("landmarks/uav2" in flight.node.alarms) is bool(off_m)


def test_a_peer_whose_clock_is_an_hour_ahead_is_used_and_named(fly: Callable[..., Flight]) -> None:
    flight, ahead_s = fly(), 3600
    peer = flight.peer("wideband")
    for second in (1, 2, 3):
        flight.epoch(second)
        peer.publish(flight.packet(second + ahead_s))
        assert flight.spin(lambda: flight.newest_ns() == (second + ahead_s) * NS_PER_S)  # noqa: B023
    (link,) = flight.epoch(4).peers
    assert (link.packets_received, link.packets_used, list(link.drop_reasons)) == (3, 3, [])
    assert link.age_s == pytest.approx(1.0)
    assert "3600 s ahead" in flight.node.notes["clock/uav2"]


def test_in_wideband_a_peer_gets_the_fused_estimate_of_its_landmarks(fly: Callable[..., Flight]) -> None:
    flight = fly("fusion.feedback:=true")
    feedback: list[LandmarkInformation] = []
    listener = flight.others.create_subscription(LandmarkInformation, "/uav2/fusion/feedback", feedback.append, STATE)
    publisher = flight.peer("wideband")
    assert flight.spin(lambda: listener.get_publisher_count() > 0)
    publisher.publish(flight.packet(1))
    assert flight.spin(lambda: flight.newest_ns() == NS_PER_S)
    flight.epoch(2)
    assert flight.spin(lambda: feedback)
    assert feedback[0].vehicle == "uav1"
    assert "uav2/1" in feedback[0].sources
    returned = flight.others.create_publisher(LandmarkInformation, "/uav1/fusion/feedback", STATE)
    assert flight.spin(lambda: returned.get_subscription_count() > 0)
    returned.publish(flight.packet(2))
    assert flight.spin(lambda: "uav2" in flight.node._fusion.returned.peers)
    flight.set("fusion.mode", "narrowband")
    assert flight.spin(lambda: listener.get_publisher_count() == 0)


def test_the_exchange_follows_its_parameters(fly: Callable[..., Flight]) -> None:
    flight = fly("fusion.feedback:=false", peers="[uav2, uav3, uav4]")
    flight.listen("wideband")
    publisher = flight.peer("wideband")
    returned = flight.others.create_subscription(LandmarkInformation, "/uav2/fusion/feedback", lambda _: None, STATE)
    assert flight.epoch(1).packets_sent == 1
    assert flight.spin(lambda: flight.received)
    assert len(flight.received[-1].ids) == 6

    assert flight.set("fusion.max_packet_landmarks", 2).successful
    flight.epoch(2)
    assert flight.spin(lambda: len(flight.received) == 2)
    assert len(flight.received[-1].ids) == 2

    assert flight.set("fusion.relay", True).successful
    publisher.publish(flight.packet(2, of="uav3"))
    assert flight.spin(lambda: len(flight.received) == 3)
    assert flight.received[-1].vehicle == "uav3"

    publisher.publish(flight.packet(2))
    assert flight.spin(lambda: flight.newest_ns() == 2 * NS_PER_S)
    silent_of_2, *_ = flight.epoch(4).peers
    assert not silent_of_2.silent
    assert flight.set("fusion.silent_after_s", 1.0).successful
    assert [link.silent for link in flight.epoch(5).peers] == [True, True]

    assert flight.set("fusion.feedback", True).successful
    assert flight.spin(lambda: returned.get_publisher_count() > 0)
    assert flight.set("fusion.feedback", False).successful
    assert flight.spin(lambda: returned.get_publisher_count() == 0)

    sent = flight.epoch(6).packets_sent
    assert flight.set("fusion.budget_bytes_per_s", 1).successful
    status = flight.epoch(7)
    assert (status.packets_sent, status.packets_held_back) == (sent, 1)


def test_a_setting_that_leaves_the_budget_alone_does_not_refill_it(fly: Callable[..., Flight]) -> None:
    flight = fly("fusion.budget_bytes_per_s:=1500")
    sent = flight.epoch(1).bytes_sent
    left = flight.node._exchange.outbox.available(NS_PER_S)
    assert sent > 0
    assert flight.set("fusion.relay", True).successful
    assert flight.node._exchange.outbox.available(NS_PER_S) == left


@pytest.mark.parametrize("relay", [True, False])
def test_a_relay_forwards_new_packets_unchanged(fly: Callable[..., Flight], relay: bool) -> None:
    flight = fly(f"fusion.relay:={str(relay).lower()}", peers="[uav2, uav3, uav4]")
    flight.listen("wideband")
    publisher = flight.peer("wideband")
    direct, sent_on, homecoming = (flight.packet(1, of=name) for name in ("uav2", "uav3", "uav1"))
    for message in (direct, sent_on, sent_on, homecoming):
        publisher.publish(message)
    assert flight.spin(lambda: "uav3" in flight.node._fusion.inbox.peers)
    flight.rest()
    assert [message.vehicle for message in flight.received] == (["uav2", "uav3"] if relay else [])
    assert flight.received == ([direct, sent_on] if relay else [])
    assert flight.node._exchange.outbox.packets_sent == len(flight.received)
    assert sum(flight.node.counts[key] for key in list(flight.node.counts) if key.startswith("dropped/")) == 0


def test_a_vehicle_without_a_back_end_goes_on_relaying_within_its_budget(fly: Callable[..., Flight]) -> None:
    flight = fly("fusion.relay:=true", "fusion.budget_bytes_per_s:=2000", peers="[uav2, uav3]")
    publisher, seconds = flight.peer("wideband"), itertools.count(1)
    outbox = flight.node._exchange.outbox

    def relays_more_than_it_began_with() -> bool:
        publisher.publish(flight.packet(next(seconds)))
        return outbox.bytes_sent > 2 * 2000

    assert flight.spin(relays_more_than_it_began_with)
    assert flight.node.counts["dropped/budget"] > 0


def test_a_packet_of_a_vehicle_that_is_not_of_the_fleet_is_refused(fly: Callable[..., Flight]) -> None:
    flight = fly()
    publisher = flight.peer("wideband")
    publisher.publish(flight.packet(1, of="stranger"))
    assert flight.spin(lambda: flight.node.counts["dropped/sender"] == 1)
    assert flight.node._fusion.inbox.peers == {}


@pytest.mark.parametrize(("own", "theirs"), [("wideband", "narrowband"), ("narrowband", "wideband")])
def test_vehicles_in_different_modes_receive_each_other(fly: Callable[..., Flight], own: str, theirs: str) -> None:
    flight = fly(f"fusion.mode:={own}")
    publisher = flight.peer(theirs)
    publisher.publish(flight.packet(1))
    assert flight.spin(lambda: "uav2" in flight.node._fusion.inbox.peers)
    assert flight.node.counts["radio/uav2/incompatible_qos"] == 1  # found out from the middleware, and cured
    assert flight.node.notes["radio/uav2/matched"] == "1"
    flight.others.destroy_publisher(publisher)
    assert flight.spin(lambda: flight.node.notes["radio/uav2/matched"] == "0")


def test_joint_information_of_epochs_before_the_start_is_no_drop_and_late_one_is(fly: Callable[..., Flight]) -> None:
    """A node that is restarted gets what the back end keeps for late joiners: more epochs than odometry."""
    flight = fly()
    begin, dropped = 10, "dropped/joint_late"
    assert flight.spin(lambda: flight.node._previous_ns == NS_PER_S // 2)
    flight.node.reset()
    flight._move(begin * NS_PER_S + NS_PER_S // 2)
    assert flight.spin(lambda: flight.node._previous_ns == begin * NS_PER_S + NS_PER_S // 2)
    for second in (begin - 2, begin - 1, begin):
        flight._joints.publish(joint_to_msg(flight.joint(second, "uav1"), frame_id="uav1/map"))
    assert flight.epoch(begin + 1).header.stamp.sec == begin + 1
    assert flight.node.counts[dropped] == 0
    flight._move(begin * NS_PER_S + 19 * NS_PER_S // 10)
    assert flight.spin(lambda: flight.node._previous_ns == begin * NS_PER_S + 19 * NS_PER_S // 10)
    late = dataclasses.replace(flight.joint(begin, "uav1"), stamp_ns=(begin + 1) * NS_PER_S + NS_PER_S // 2)
    flight._joints.publish(joint_to_msg(late, frame_id="uav1/map"))
    assert flight.spin(lambda: flight.node.counts[dropped] == 1)


def test_an_input_of_another_type_is_named_and_moves_no_qos(fly: Callable[..., Flight], domain_id: int) -> None:
    flight, context = fly(), rclpy.Context()
    rclpy.init(context=context, domain_id=domain_id)
    stranger = rclpy.create_node("stranger", context=context)
    wrong = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
    stranger.create_publisher(String, "/uav1/initial_state", wrong)
    one = flight.node.listen(NavigationState, "initial_state", print, LATCHED)
    said = "initial_state (published as std_msgs/msg/String; it takes uav_vslam_msgs/msg/NavigationState)"
    try:
        assert flight.spin(lambda: said in flight.node._health()[1])
        assert not one.follow(flight.node)
        assert one.qos.reliability == ReliabilityPolicy.RELIABLE
        flight.others.create_publisher(NavigationState, "/uav1/initial_state", LATCHED)
        assert flight.spin(lambda: said not in flight.node._health()[1])
        assert "initial_state" in flight.node._health()[1]
    finally:
        stranger.destroy_node()
        rclpy.shutdown(context=context)


def test_a_missed_deadline_and_bytes_that_are_no_packet_are_counted(fly: Callable[..., Flight]) -> None:
    flight = fly("fusion.mode:=narrowband")
    publisher = flight.peer("narrowband")
    publisher.publish(b"\x00\x01\x00\x00nonsense")
    assert flight.spin(lambda: flight.node.counts["dropped/undecodable"] == 1)
    assert flight.spin(lambda: flight.node.counts["radio/uav2/deadline"] > 0)
    assert flight.node._fusion.inbox.peers == {}


def test_a_node_that_was_paused_receives_its_peers_again(fly: Callable[..., Flight]) -> None:
    flight = fly()
    publisher = flight.peer("wideband")
    flight.node.trigger_deactivate()
    flight.node.trigger_activate()
    assert flight.spin(lambda: publisher.get_subscription_count() > 0)
    publisher.publish(flight.packet(1))
    assert flight.spin(flight.newest_ns)


def test_odometry_waits_for_a_lost_epoch_no_longer_than_until_the_next_one(fly: Callable[..., Flight]) -> None:
    flight = fly()
    flight.epoch(1)
    for k in range(1, 4):  # of a pause, in which the joint information of the second epoch was ignored
        flight._move(2 * NS_PER_S + k * NS_PER_S // 4)
    flight.epoch(3)
    assert flight.node.counts["dropped/joint_lost"] == 1
    assert flight.node._previous_ns == 3 * NS_PER_S


def test_a_radio_domain_carries_the_packets_and_nothing_else(
    fly: Callable[..., Flight], make_domain_id: Callable[[], int], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ROS_STATIC_PEERS", "127.0.0.1")
    radio_id = make_domain_id()
    flight = fly(f"radio_domain_id:={radio_id}", "radio_peers:=['127.0.0.1']", "fusion.feedback:=true")
    assert os.environ["ROS_STATIC_PEERS"] == "127.0.0.1"
    flight.node.trigger_deactivate()
    flight.node.trigger_activate()
    context = rclpy.Context()
    context.init(args=[], domain_id=radio_id)
    peer = rclpy.create_node(
        "uav2",
        context=context,
        use_global_arguments=False,
        enable_rosout=False,
        start_parameter_services=False,
        parameter_overrides=[Parameter("start_type_description_service", value=False)],
    )
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(peer)
    try:
        flight.listen("wideband", node=peer)
        flight.epoch(1)
        assert flight.spin(lambda: executor.spin_once(timeout_sec=0.02) or flight.received)
        flight.listen("wideband", node=peer)
        assert flight.spin(lambda: flight.node._exchange._transport.copies == 2)
        assert "/uav2/landmark_information (no publisher)" in flight.node._awaited()
        peer.create_publisher(LandmarkInformation, "/uav2/landmark_information", RADIO["wideband"])
        said = "/uav2/landmark_information (published, but no message yet)"
        assert flight.spin(lambda: said in flight.node._awaited())
        size = len(serialize_message(flight.received[0]))
        assert flight.epoch(2).bytes_sent == (1 + 2) * size  # each peer is sent its own copy
        carried = {PACKETS, "/uav1/fusion/feedback", "/uav2/fusion/feedback", "/uav2/landmark_information"}
        own = {"/parameter_events"}
        flight.spin(lambda: {topic for topic, _ in peer.get_topic_names_and_types()} - own == carried)
        assert {topic for topic, _ in peer.get_topic_names_and_types()} - own == carried
        assert flight.spin(lambda: peer.count_publishers("/parameter_events") == 1)
        assert peer.count_subscribers(PACKETS) == 2  # the peer's own two: uav1 only sends there
        assert peer.get_service_names_and_types() == []
        assert flight.others.get_publishers_info_by_topic(PACKETS) == []
        assert flight.others.get_subscriptions_info_by_topic("/uav2/landmark_information") == []
    finally:
        executor.shutdown()
        peer.destroy_node()
        context.try_shutdown()


def test_the_frame_of_a_peer_without_a_common_origin_is_published(fly: Callable[..., Flight]) -> None:
    flight = fly("fusion.common_origin:=false")
    rng = np.random.default_rng(5)
    points, shift = np.column_stack([rng.uniform(-40, 40, (20, 2)), rng.uniform(-3, 3, 20)]), [30.0, -8.0, 2.0]
    edges: list[Any] = []
    received = flight.others.create_subscription(TFMessage, "/tf", lambda m: edges.extend(m.transforms), STATE)
    assert flight.spin(received.get_publisher_count)

    def joint(second: int, vehicle: str) -> JointInformation:
        at = points + (shift if vehicle == "uav2" else np.zeros(3))
        P = np.diag([1e-2] * 6 + [1e-2] * 60)
        return flight._make_joint(at, P, vehicle=vehicle, stamp_ns=second * NS_PER_S)

    flight.joint = joint
    flight.peer("wideband").publish(flight.packet(1))
    assert flight.spin(flight.newest_ns)
    flight.epoch(3)
    assert flight.spin(lambda: any(edge.child_frame_id == "uav1/uav2/map" for edge in edges))
    edge = next(edge for edge in edges if edge.child_frame_id == "uav1/uav2/map")
    assert edge.header.frame_id == "uav1/world"
    assert {edge.header.frame_id for edge in edges} == {"uav1/world"}  # all vehicles may share one graph
    t = edge.transform.translation
    np.testing.assert_allclose([t.x, t.y, t.z], -np.array(shift), rtol=0, atol=0.1)
    assert flight.node.notes["frame/uav2"] == "found"


def test_fused_odometry_has_the_own_twist_and_the_frames_that_are_configured(fly: Callable[..., Flight]) -> None:
    flight = fly("frames.world:=common", "frames.map:=first/map", "input.frames.base:=first/body")
    fused: list[Odometry] = []
    edges: list[Any] = []
    flight.others.create_subscription(Odometry, "/uav1/fused/odometry", fused.append, STATE)
    received = flight.others.create_subscription(TFMessage, "/tf", lambda m: edges.extend(m.transforms), STATE)
    assert flight.spin(received.get_publisher_count)
    flight.epoch(1)
    assert flight.spin(lambda: fused and edges)
    assert (fused[-1].header.frame_id, fused[-1].child_frame_id) == ("common", "first/body")
    assert (edges[-1].header.frame_id, edges[-1].child_frame_id) == ("common", "first/map")
    assert fused[-1].twist.twist.linear.x == 20.0
    np.testing.assert_array_equal(fused[-1].twist.covariance.reshape(6, 6), np.eye(6))
