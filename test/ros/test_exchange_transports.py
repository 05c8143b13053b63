# SPDX-License-Identifier: Apache-2.0
"""One script of events through the twin's links and through the radio over DDS: the same packets, drops and counts."""

import dataclasses
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

rclpy = pytest.importorskip("rclpy", reason="needs ROS")
from rclpy.executors import SingleThreadedExecutor  # noqa: E402
from rclpy.serialization import deserialize_message  # noqa: E402

from uav_vslam.config import FusionConfig  # noqa: E402
from uav_vslam.cooperation.exchange import Exchange, Transport  # noqa: E402
from uav_vslam.cooperation.fusion import Fusion  # noqa: E402
from uav_vslam.cooperation.inbox import Inbox  # noqa: E402
from uav_vslam.fleet import Air, LinkTransport, Sent  # noqa: E402
from uav_vslam.ros.packet_message import packet_from_msg, packet_to_msg  # noqa: E402
from uav_vslam.ros.qos import RADIO  # noqa: E402
from uav_vslam.ros.radio import Radio  # noqa: E402
from uav_vslam.ros.vehicle_node import VehicleNode  # noqa: E402
from uav_vslam.slam.packet import canonical_bytes  # noqa: E402
from uav_vslam.types import NS_PER_S, JointInformation, LandmarkPacket  # noqa: E402
from uav_vslam_msgs.msg import LandmarkInformation  # noqa: E402

pytestmark = pytest.mark.ros

PEERS = ("uav2", "uav3", "uav4")
SETTINGS = FusionConfig(feedback=True, relay=True, budget_bytes_per_s=3000)
PATIENCE_S = 60.0  # a busy machine only waits longer
QUIET_S = 0.5  # long enough for what should not come
Event = tuple[str, Any, Any]  # what happens to uav1, from whom, with what
Crossed = tuple[str, int, bytes]  # (to whom, serialised size, every field)


def every_field(packet: LandmarkPacket) -> bytes:
    """Return the bytes of a packet but for those that DDS puts in for alignment, which it leaves undefined."""
    return canonical_bytes(packet) + packet.checksum.to_bytes(4, "little") + packet.tag


class Vehicle:
    """uav1 with its exchange; what leaves it is collected.

    Attributes:
        crossed: what crossed the radio since the last event.
    """

    def __init__(self, transport: Transport, **options: Any) -> None:
        self.fusion = Fusion("uav1", SETTINGS)
        self.exchange = Exchange(self.fusion, PEERS, transport, SETTINGS, **options)
        self.crossed: list[Crossed] = []

    def epoch(self, _: None, joint: JointInformation) -> None:
        self.fusion.fuse(joint)
        self.exchange.send()

    def counts(self) -> dict[str, Any]:
        """Return all that is counted, and what fusion made of it."""
        outbox, epoch = self.exchange.outbox, self.fusion.epoch
        return {
            "sent": (outbox.packets_sent, outbox.bytes_sent),
            "dropped": dict(self.exchange.dropped),
            "received": dict(self.exchange.received_bytes),
            "inboxes": [_counted(inbox) for inbox in (self.fusion.inbox, self.fusion.returned)],
            "fused": epoch and (epoch.pose.T_map_body.t.tolist(), epoch.covariance.tolist()),
        }


def _counted(inbox: Inbox) -> Any:
    records = {
        name: (record.received, dict(record.dropped), list(record.recently_used))
        for name, record in inbox.peers.items()
    }
    return records, dict(inbox.refused)


class Twin(Vehicle):
    """Over the links of the offline twin."""

    def __init__(self) -> None:
        self.air = Air(("uav1", *PEERS))
        super().__init__(LinkTransport(self.air, "uav1"))
        for peer in PEERS:
            self.air.receivers[peer] = Ear(peer, self)

    def happen(self, event: Event) -> list[Crossed]:
        self.crossed = []
        kind, sender, what = event
        getattr(self, kind)(sender, what)
        for _ in ("to uav1", "from uav1"):
            self.air.deliver(self.air.now_ns)
        return list(dict.fromkeys(self.crossed))  # what several hear crosses the radio once

    def epoch(self, _: None, joint: JointInformation) -> None:
        self.air.deliver(joint.stamp_ns)
        super().epoch(_, joint)

    def tune(self, _: None, mode: str) -> None:
        self.exchange.configure(dataclasses.replace(self.exchange.settings, mode=mode))

    def packet(self, sender: str, packet: LandmarkPacket) -> None:
        self.air.send(sender, "uav1", Sent(packet))

    def feedback(self, sender: str, packet: LandmarkPacket) -> None:
        self.air.send(sender, "uav1", Sent(packet, feedback=True))


@dataclasses.dataclass
class Ear:
    """A peer of the twin that only listens."""

    name: str
    twin: Twin

    def on_packet(self, sender: str, packet: LandmarkPacket, size_bytes: int) -> None:
        self._note("all", packet, size_bytes)

    def on_feedback(self, packet: LandmarkPacket, size_bytes: int) -> None:
        self._note(self.name, packet, size_bytes)

    def _note(self, to: str, packet: LandmarkPacket, size_bytes: int) -> None:
        self.twin.crossed.append((to, size_bytes, every_field(packet)))


class OverDds(Vehicle):
    """Over the radio, in a domain of its own; a second node plays the peers."""

    def __init__(self, domain_id: int) -> None:
        rclpy.init(args=["--ros-args", "-r", "__ns:=/uav1"], domain_id=domain_id)
        self.executor = SingleThreadedExecutor()
        self.node = VehicleNode("fusion")
        self.others = rclpy.create_node("others", use_global_arguments=False)
        for node in (self.node, self.others):
            self.executor.add_node(node)
        self.radio = Radio(self.node, PEERS, host=None)
        super().__init__(self.radio, on_drop=self.node.drop)
        self._publishers: dict[tuple[str, str], Any] = {}  # by kind of event and sender
        self._subscriptions: list[Any] = []
        self._crossed_before = 0

    def happen(self, event: Event) -> list[Crossed]:
        self._crossed_before += len(self.crossed)
        self.crossed = []
        kind, sender, what = event
        getattr(self, kind)(sender, what)
        sent = self.exchange.outbox
        self.wait(lambda: self._crossed_before + len(self.crossed) == sent.packets_sent)
        return self.crossed

    def tune(self, _: None, mode: str) -> None:
        """Change the mode and wait until all who should hear each other do."""
        self.exchange.configure(dataclasses.replace(self.exchange.settings, mode=mode))
        for one in self._publishers.values():
            self.others.destroy_publisher(one)
        for one in self._subscriptions:
            self.others.destroy_subscription(one)
        self._publishers, self._subscriptions = {}, []
        if mode == "none":
            return
        self._open("packet", PEERS, [f"/{peer}/landmark_information" for peer in PEERS], mode)
        self._listen("all", "/uav1/landmark_information", mode)
        if self.exchange.settings.returns_feedback:
            self._open("feedback", PEERS, ["/uav1/fusion/feedback"] * len(PEERS), mode)
            for peer in PEERS:
                self._listen(peer, f"/{peer}/fusion/feedback", mode)
        outputs = (self.radio._publisher, *self.radio._returns.values(), *self._publishers.values())
        self.wait(lambda: all(one.get_subscription_count() == 1 for one in outputs))
        inputs = (*self._subscriptions, *(one.subscription for one in self.radio._inputs))
        self.wait(lambda: all(one.get_publisher_count() for one in inputs))

    def packet(self, sender: str, packet: LandmarkPacket) -> None:
        self._publish("packet", sender, packet)

    def feedback(self, sender: str, packet: LandmarkPacket) -> None:
        self._publish("feedback", sender, packet)

    def _publish(self, kind: str, sender: str, packet: LandmarkPacket) -> None:
        """Send as a peer, and wait until uav1 has received it."""
        publisher, before = self._publishers.get((kind, sender)), self._received
        if publisher is not None:  # or else the mode has no such channel
            publisher.publish(packet_to_msg(packet))
            self.wait(lambda: self._received == before + 1)

    @property
    def _received(self) -> int:
        return sum(one.received for one in self.radio._inputs)

    def _open(self, kind: str, senders: tuple[str, ...], topics: list[str], mode: str) -> None:
        for sender, topic in zip(senders, topics, strict=True):
            publisher = self.others.create_publisher(LandmarkInformation, topic, RADIO[mode])
            self._publishers[kind, sender] = publisher

    def _listen(self, to: str, topic: str, mode: str) -> None:
        def note(data: bytes) -> None:
            packet = packet_from_msg(deserialize_message(data, LandmarkInformation))
            self.crossed.append((to, len(data), every_field(packet)))

        made = self.others.create_subscription(LandmarkInformation, topic, note, RADIO[mode], raw=True)
        self._subscriptions.append(made)

    def wait(self, until: Callable[[], bool]) -> None:
        end_s = time.monotonic() + PATIENCE_S
        while not until():
            assert time.monotonic() < end_s
            self.executor.spin_once(timeout_sec=0.02)

    def rest(self) -> None:
        end_s = time.monotonic() + QUIET_S
        while time.monotonic() < end_s:
            self.executor.spin_once(timeout_sec=0.02)

    def close(self) -> None:
        self.executor.shutdown()
        self.node.destroy_node()
        self.others.destroy_node()
        rclpy.try_shutdown()


@pytest.fixture
def over_dds(domain_id: int) -> Iterator[OverDds]:
    vehicle = OverDds(domain_id)
    yield vehicle
    vehicle.close()


class Writer:
    """Makes the packets of the script, each vehicle's from a fusion of its own."""

    def __init__(self, make_joint: Callable[..., JointInformation]) -> None:
        self._make_joint = make_joint

    def joint(self, vehicle: str, second: int, session: int = 1) -> JointInformation:
        points = [[4.0 * k, 7.0 * (k % 3), 0.0] for k in range(6)]
        stamp_ns = second * NS_PER_S
        return self._make_joint(points, np.eye(24), vehicle=vehicle, session=session, stamp_ns=stamp_ns)

    def packet(self, vehicle: str, second: int, *, session: int = 1, mode: str = "wideband") -> LandmarkPacket:
        fusion = Fusion(vehicle, dataclasses.replace(SETTINGS, mode=mode))
        fusion.fuse(self.joint(vehicle, second, session))
        return fusion.packet()

    def feedback(self, vehicle: str, second: int) -> LandmarkPacket:
        """Return what a vehicle's fusion made of landmarks of uav1."""
        fusion = Fusion(vehicle, SETTINGS)
        fusion.inbox.add(self.packet("uav1", second - 1))
        fusion.fuse(self.joint(vehicle, second))
        made = fusion.feedback("uav1")
        assert made is not None
        return made


def garbled(packet: LandmarkPacket) -> LandmarkPacket:
    return dataclasses.replace(packet, checksum=packet.checksum ^ 1)


def script(write: Writer) -> list[Event]:
    def epoch(second: int) -> Event:
        return "epoch", None, write.joint("uav1", second)

    def packet(sender: str, what: LandmarkPacket) -> Event:
        return "packet", sender, what

    def feedback(sender: str, what: LandmarkPacket) -> Event:
        return "feedback", sender, what

    def mode(name: str) -> Event:
        return "tune", None, name

    first, second, third = (write.packet("uav2", k) for k in (1, 2, 3))
    of_uav3 = write.packet("uav3", 2)
    returned = write.feedback("uav3", 4)
    return [
        mode("wideband"),
        epoch(1),
        epoch(2),
        packet("uav2", second),  # relayed to uav3 and uav4
        packet("uav2", first),  # reordered
        packet("uav2", second),  # repeated
        packet("uav3", second),  # comes by another route too: a duplicate
        packet("uav2", of_uav3),  # relayed to uav4 alone
        packet("uav3", of_uav3),  # now from uav3 itself
        epoch(3),
        packet("uav3", write.packet("stranger", 3)),
        packet("uav2", garbled(third)),
        packet("uav3", garbled(third)),  # garbled by who relayed it
        packet("uav2", third),
        packet("uav2", write.packet("uav1", 2)),  # an own packet comes back
        packet("uav3", returned),  # feedback where packets are expected
        epoch(4),
        feedback("uav3", returned),
        feedback("uav3", returned),
        feedback("uav2", write.feedback("stranger", 4)),
        feedback("uav2", garbled(write.feedback("uav2", 4))),
        epoch(5),
        *(packet("uav2", write.packet("uav2", second)) for second in (4, 5, 6, 7)),  # more than can be relayed
        packet("uav2", first),  # late
        epoch(6),
        packet("uav2", write.packet("uav2", 7, session=2)),  # who sends this, while session 1 goes on?
        epoch(7),
        packet("uav3", write.packet("uav3", 6, session=2)),  # uav3 was restarted
        packet("uav3", write.packet("uav3", 7)),  # and this is from before
        epoch(8),
        mode("narrowband"),
        epoch(9),
        epoch(10),
        packet("uav4", write.packet("uav4", 9, mode="narrowband")),
        feedback("uav3", write.feedback("uav3", 10)),  # nobody listens
        *(epoch(second) for second in range(11, 22)),  # no peer is received: most epochs are left to discovery
        mode("none"),
        packet("uav2", write.packet("uav2", 21)),
        epoch(22),
        mode("wideband"),
        packet("uav2", write.packet("uav2", 22)),
        packet("uav4", write.packet("uav4", 22)),
        epoch(23),
        epoch(26),
        epoch(30),
    ]


@pytest.mark.parametrize("mode", sorted(RADIO))
def test_what_a_peer_sends_and_relays_while_the_node_is_busy_arrives(
    over_dds: OverDds, make_joint: Callable[..., JointInformation], mode: str
) -> None:
    """Epochs are at the same stamps in all vehicles: a relay's packets come together, while the others fuse."""
    write = Writer(make_joint)
    over_dds.happen(("tune", None, mode))
    for peer in PEERS:
        relayed = packet_to_msg(write.packet(peer, 2, mode=mode))
        over_dds._publishers["packet", "uav2"].publish(relayed)
    time.sleep(QUIET_S)
    over_dds.wait(lambda: over_dds._received == len(PEERS))
    assert over_dds.fusion.inbox.peers.keys() == set(PEERS)


def test_one_script_gives_the_same_packets_drops_and_counts(
    over_dds: OverDds, make_joint: Callable[..., JointInformation]
) -> None:
    twin, everything, relayed = Twin(), [], 0
    for number, event in enumerate(script(Writer(make_joint))):
        crossed = [sorted(vehicle.happen(event)) for vehicle in (twin, over_dds)]
        assert crossed[0] == crossed[1], (number, event[:2])
        assert twin.counts() == over_dds.counts(), (number, event[:2])
        everything += crossed[0]
        relayed += len(crossed[0]) if event[0] == "packet" else 0
    over_dds.rest()
    assert over_dds.happen(("tune", None, "none")) == []  # nothing more had been under way
    dropped = {reason: count for reason, count in over_dds.node.counts.items() if reason.startswith("dropped/")}
    assert dropped == {f"dropped/{reason}": count for reason, count in twin.exchange.dropped.items()}
    assert sum(size for _, size, _ in everything) == twin.exchange.outbox.bytes_sent
    # The script has met what it is about.
    expected = {
        "sender": 2,
        "sources": 1,
        "checksum": 3,
        "duplicate": 3,
        "late": 1,
        "stale_session": 1,
        "other_session": 1,
    }
    assert twin.exchange.dropped.items() >= expected.items()
    assert twin.exchange.dropped["budget"] >= 2
    assert relayed >= 5
    assert twin.fusion.inbox.refused["own"] == 1
    assert {to for to, _, _ in everything} == {"all", "uav2", "uav3", "uav4"}
