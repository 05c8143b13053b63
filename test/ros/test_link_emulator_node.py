# SPDX-License-Identifier: Apache-2.0
"""The emulated radio in the graph: packets pass as configured, on the ROS clock, and their fate is reported."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

rclpy = pytest.importorskip("rclpy", reason="needs ROS")
from diagnostic_msgs.msg import DiagnosticArray  # noqa: E402
from rclpy.executors import SingleThreadedExecutor  # noqa: E402
from rosgraph_msgs.msg import Clock  # noqa: E402

from uav_vslam.errors import ConfigError  # noqa: E402
from uav_vslam.ros.convert import stamp_from_ns  # noqa: E402
from uav_vslam.ros.link_emulator_node import LinkEmulatorNode  # noqa: E402
from uav_vslam.ros.qos import RADIO  # noqa: E402
from uav_vslam.types import NS_PER_S  # noqa: E402
from uav_vslam_msgs.msg import LandmarkInformation  # noqa: E402
from waiting import wait_for  # noqa: E402

pytestmark = pytest.mark.ros

QUIET_TURNS = 15  # enough for what should not come
VEHICLES = ("uav1", "uav2", "uav3")


class Air:
    """An emulator over three vehicles, a clock that is set by hand, and a subscription at every receiver."""

    def __init__(self, link: Path, mode: str, domain_id: int) -> None:
        parameters = ["-p", f"vehicles:=[{', '.join(VEHICLES)}]", "-p", "use_sim_time:=true"]
        parameters += ["--params-file", str(link)]
        rclpy.init(args=["--ros-args", *parameters], domain_id=domain_id)
        self.executor = SingleThreadedExecutor()
        self.node = LinkEmulatorNode()
        self.others = rclpy.create_node("others", use_global_arguments=False)
        self.executor.add_node(self.node)
        self.executor.add_node(self.others)
        self.received: list[tuple[str, str, int]] = []  # (receiver, sender, sequence)
        self.diagnostics: dict[str, str] = {}
        self.others.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 10)
        subscriptions = [self._listen(r, s) for r in VEHICLES for s in VEHICLES if r != s]
        self._clock = self.others.create_publisher(Clock, "/clock", 10)
        self._senders = {
            name: self.others.create_publisher(LandmarkInformation, f"/{name}/landmark_information", RADIO[mode])
            for name in VEHICLES
        }
        assert self.spin(lambda: all(subscription.get_publisher_count() for subscription in subscriptions))
        assert self.spin(lambda: all(p.get_subscription_count() for p in self.node._outputs.values()))
        assert self.spin(lambda: all(p.get_subscription_count() for p in self._senders.values()))
        assert self.spin(lambda: self._clock.get_subscription_count())

    def _listen(self, receiver: str, sender: str) -> Any:
        def on_message(message: LandmarkInformation) -> None:
            self.received.append((receiver, sender, message.sequence))

        return self.others.create_subscription(LandmarkInformation, f"/{receiver}/received/{sender}", on_message, 10)

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        self.diagnostics = {entry.key: entry.value for entry in message.status[0].values}

    def turn(self) -> None:
        self.executor.spin_once(timeout_sec=0.02)

    def spin(self, until: Callable[[], Any]) -> bool:
        return wait_for(until, self.turn)

    def at(self, time_s: float) -> None:
        """Set the clock, and process what arrives."""
        now_ns = round(time_s * NS_PER_S)
        self._clock.publish(Clock(clock=stamp_from_ns(now_ns)))
        assert self.spin(lambda: self.node.get_clock().now().nanoseconds == now_ns)
        for _ in range(QUIET_TURNS):
            self.turn()

    def send(self, sender: str, sequence: int) -> None:
        count = sum(link.packets["offered"] for link in self.node._links.values())
        self._senders[sender].publish(LandmarkInformation(vehicle=sender, sequence=sequence))
        assert self.spin(lambda: sum(link.packets["offered"] for link in self.node._links.values()) == count + 2)


@pytest.fixture
def air(tmp_path: Path, domain_id: int) -> Iterator[Callable[..., Air]]:
    made: list[Air] = []

    def make(text: str, mode: str = "wideband") -> Air:
        (tmp_path / "link.yaml").write_text(f"/**: {{ros__parameters: {{link: {{{text}}}}}}}")
        made.append(Air(tmp_path / "link.yaml", mode, domain_id))
        return made[-1]

    yield make
    for one in made:
        one.executor.shutdown()
        one.node.destroy_node()
        one.others.destroy_node()
    rclpy.try_shutdown()


@pytest.mark.parametrize("mode", ["wideband", "narrowband"])
def test_a_packet_reaches_every_peer_after_the_delay_by_the_ros_clock(air: Callable[..., Air], mode: str) -> None:
    radio = air("delay_s: 1.0", mode)
    radio.at(100.0)
    radio.send("uav1", 7)
    radio.at(100.9)
    assert radio.received == []
    radio.at(101.0)
    assert radio.spin(lambda: len(radio.received) == 2)
    assert sorted(radio.received) == [("uav2", "uav1", 7), ("uav3", "uav1", 7)]


def test_feedback_that_cannot_be_decoded_is_dropped_and_counted(air: Callable[..., Air]) -> None:
    radio = air("delay_s: 0.0")
    feedback = radio.others.create_publisher(LandmarkInformation, "/uav2/fusion/feedback", RADIO["wideband"])
    assert radio.spin(feedback.get_subscription_count)
    feedback.publish(b"\x00\x01\x00\x00nonsense")
    assert radio.spin(lambda: radio.diagnostics.get("dropped/undecodable") == "1")
    radio.at(100.0)
    radio.send("uav1", 7)


def test_the_fate_of_packets_is_reported_by_direction(air: Callable[..., Air]) -> None:
    radio = air("blackouts: [1.0, 2.0], duplication: 1.0")
    for second in (100, 101, 102):
        radio.at(second)
        radio.send("uav2", second)
    radio.at(103.0)
    expected = [(receiver, "uav2", second) for receiver in ("uav1", "uav3") for second in (100, 100, 102, 102)]
    assert radio.spin(lambda: len(radio.received) == len(expected))
    assert sorted(radio.received) == expected
    assert radio.spin(lambda: radio.diagnostics.get("uav2>uav1/delivered", "").startswith("4 packets"))
    told = {key: value.split(" ")[0] for key, value in radio.diagnostics.items() if key.startswith("uav2>uav3")}
    fates = {"offered": "3", "blacked_out": "1", "duplicated": "2", "delivered": "4", "queued": "0"}
    assert told == {f"uav2>uav3/{fate}": count for fate, count in fates.items()}


def test_feedback_uses_the_link_of_its_sender(air: Callable[..., Air]) -> None:
    radio = air("delay_s: 1.0")
    received: list[LandmarkInformation] = []
    subscription = radio.others.create_subscription(LandmarkInformation, "/uav1/received/feedback", received.append, 10)
    sender = radio.others.create_publisher(LandmarkInformation, "/uav1/fusion/feedback", RADIO["wideband"])
    assert radio.spin(lambda: subscription.get_publisher_count() and sender.get_subscription_count())
    assert radio.spin(lambda: radio.node._returns["uav1"].get_subscription_count())
    radio.at(100.0)
    for vehicle in ("stranger", "uav3"):
        sender.publish(LandmarkInformation(vehicle=vehicle))
    assert radio.spin(lambda: radio.node._links["uav3", "uav1"].packets["offered"] == 1)
    radio.at(100.9)
    assert received == []
    radio.at(101.0)
    assert radio.spin(lambda: received)
    assert [message.vehicle for message in received] == ["uav3"]


def test_missing_vehicles_are_reported(domain_id: int) -> None:
    rclpy.init(args=["--ros-args", "-p", "vehicles:=[uav1]"], domain_id=domain_id)
    try:
        with pytest.raises(ConfigError, match="set the parameter vehicles"):
            LinkEmulatorNode()
    finally:
        rclpy.try_shutdown()
