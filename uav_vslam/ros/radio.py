# SPDX-License-Identifier: Apache-2.0
"""What crosses the radio: one publisher, one subscription a peer, and nothing else.

With a domain of its own, the radio is a second context with one bare node, the only participant that other vehicles
discover: neither parameters nor logs nor the vehicle's other topics are announced there. See docs/radio.md.
"""

import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from rclpy.clock import Clock, ClockType
from rclpy.context import Context
from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message

from uav_vslam.errors import InvalidMessage
from uav_vslam.ros.inputs import Input
from uav_vslam.ros.qos import RADIO, asking_no_more
from uav_vslam.ros.runtime import VehicleNode
from uav_vslam_msgs.msg import LandmarkInformation

POLL_S = 0.05  # how often the second context is looked after: packets come once a second
CALLBACKS_A_TURN = 4
DISCOVERY = ("ROS_AUTOMATIC_DISCOVERY_RANGE", "ROS_STATIC_PEERS")  # read by a context when it is initialised

OnPacket = Callable[[str, LandmarkInformation, bytes], None]  # (peer, message, as it came)


def open_participant(name: str) -> "Participant | None":
    """Open the radio as the parameters of the node of that name tell, before the node itself opens its domain.

    The first participant of a process has the port that peers look for, so the parameters are read by a node that is
    gone before it. They are `radio_domain_id` (-1: the radio shares the vehicle's domain) and `radio_peers`.
    """
    reader = Node(name, enable_rosout=False, start_parameter_services=False)
    domain_id = reader.declare_parameter("radio_domain_id", -1).value
    addresses = [address for address in reader.declare_parameter("radio_peers", [""]).value if address]
    namespace = reader.get_namespace()
    reader.destroy_node()
    return Participant(namespace, domain_id, addresses) if domain_id >= 0 else None


class Participant:
    """A bare node in a context and domain of its own, spun by a timer of the vehicle's node."""

    def __init__(self, namespace: str, domain_id: int, addresses: Sequence[str]) -> None:
        """Open it.

        Args:
            namespace: of the vehicle.
            domain_id: of the radio.
            addresses: of the other vehicles on the radio; whether multicast finds more is for the DDS profile to say.
        """
        self._context = Context()
        with _environment(zip(DISCOVERY, ("SUBNET", ";".join(addresses)), strict=True)):
            self._context.init(args=[], domain_id=domain_id)  # the process's arguments are for the vehicle's node
        self.node = Node(
            "radio",
            context=self._context,
            namespace=namespace,
            enable_rosout=False,
            start_parameter_services=False,
            parameter_overrides=[Parameter("start_type_description_service", value=False)],
        )
        for publisher in list(self.node.publishers):  # of parameter events: it would be announced to everyone
            self.node.destroy_publisher(publisher)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)

    def serve(self, owner: Node) -> None:
        """Let a node's executor look after this one too."""
        owner.create_timer(POLL_S, self._spin, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def close(self) -> None:
        """Leave the radio."""
        self._executor.shutdown()
        self.node.destroy_node()
        self._context.try_shutdown()

    def _spin(self) -> None:
        for _ in range(CALLBACKS_A_TURN):
            self._executor.spin_once(timeout_sec=0.0)


@contextmanager
def _environment(variables: Iterable[tuple[str, str]]) -> Iterator[None]:
    """Set variables for a while."""
    before = dict(os.environ)
    os.environ.update(variables)
    try:
        yield
    finally:
        os.environ.clear()
        os.environ.update(before)


@dataclass(slots=True, kw_only=True)
class PeerInput(Input):
    """A subscription on the radio: it asks for what its mode wants, and for less where a peer offers less.

    Attributes:
        host: the node that it belongs to.
        wanted: as the mode has it.
        events: what the middleware reports.
    """

    host: Node
    wanted: QoSProfile
    events: SubscriptionEventCallbacks

    def subscribe(self, node: Node) -> None:
        """Create the subscription, to take bytes: their number is what the radio carried."""
        self.subscription = self.host.create_subscription(
            self.message_type, self.topic, self._on_message, self.qos, raw=True, event_callbacks=self.events
        )

    def follow(self, node: Node) -> bool:
        """Subscribe again where the publishers' offers ask for it; tell whether that was so."""
        offers = [info.qos_profile for info in self.host.get_publishers_info_by_topic(self.subscription.topic_name)]
        asked = asking_no_more(self.wanted, offers)
        if not offers or asked == self.qos:
            return False
        self.close()
        self.qos = asked
        self.subscribe(node)
        return True

    def close(self) -> None:
        """Stop listening."""
        self.host.destroy_subscription(self.subscription)

    def _on_message(self, message: bytes) -> None:
        self.heard = True
        self.callback(message)


class Radio:
    """The vehicle's end of the radio, in one communication mode at a time.

    Attributes:
        sent_bytes: serialised size of all that was published.
    """

    def __init__(self, node: VehicleNode, peers: Sequence[str], on_packet: OnPacket, *, host: Node | None) -> None:
        """Prepare; nothing is opened before `tune`.

        Args:
            node: counts drops and events, and watches the inputs.
            peers: names of the other vehicles.
            on_packet: called with each packet that can be decoded; may raise an error of ours.
            host: the node of a participant of its own; None: the vehicle's node itself.
        """
        self._node, self._host, self._on_packet = node, host or node, on_packet
        self._peers = tuple(peers)
        self._publisher: Any = None
        self._inputs: list[PeerInput] = []
        self.sent_bytes = 0

    def tune(self, mode: str) -> None:
        """Change the communication mode: publisher and subscriptions are made anew, or none in the mode none."""
        for one in self._inputs:
            self._node.unwatch(one)
            one.close()
        self._inputs.clear()
        if self._publisher is not None:
            self._host.destroy_publisher(self._publisher)
            self._publisher = None
        if mode not in RADIO:
            return
        topic = self._node.resolve_topic_name("landmark_information")
        events = PublisherEventCallbacks(**self._counters("deadline", "liveliness", "incompatible_qos"))
        self._publisher = self._host.create_publisher(LandmarkInformation, topic, RADIO[mode], event_callbacks=events)
        for peer in self._peers:
            self._inputs.append(self._listen(peer, RADIO[mode]))

    def send(self, data: bytes) -> None:
        """Publish a serialised packet."""
        self._publisher.publish(data)
        self.sent_bytes += len(data)

    def _listen(self, peer: str, wanted: QoSProfile) -> PeerInput:
        topic = self._node.resolve_topic_name(f"/{peer}/landmark_information")  # remapped if a link is emulated

        def take(data: bytes) -> None:
            try:
                message = deserialize_message(data, LandmarkInformation)
            except Exception as error:  # rclpy names no class for it
                raise InvalidMessage("undecodable", f"{len(data)} bytes are no packet: {error}") from None
            self._on_packet(peer, message, data)

        events = self._counters("deadline", "liveliness", "message_lost", "incompatible_qos", "matched", of=peer)
        one = PeerInput(
            message_type=LandmarkInformation,
            topic=topic,
            callback=self._node.guarded(topic, take),
            qos=wanted,
            stands_for=topic,
            host=self._host,
            wanted=wanted,
            events=SubscriptionEventCallbacks(**events),
        )
        one.subscribe(self._host)
        self._node.watch(one)
        return one

    def _counters(self, *events: str, of: str = "own") -> dict[str, Callable[[Any], None]]:
        """Return callbacks that count what the middleware reports, for the diagnostics."""

        def count(event: str) -> Callable[[Any], None]:
            def note(status: Any) -> None:
                if event == "matched":  # a peer comes, or its lease has run out
                    self._node.notes[f"radio/{of}/matched"] = str(status.current_count)
                else:
                    self._node.counts[f"radio/{of}/{event}"] += max(getattr(status, "total_count_change", 1), 1)

            return note

        return {event: count(event) for event in events}
