# SPDX-License-Identifier: Apache-2.0
"""All topics on the radio: one publisher, a subscription for each peer, and in wideband the same for feedback.

They are on a domain of its own (`radio_participant`) or on the vehicle's.
"""

import copy
import time
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.serialization import serialize_message

from uav_vslam.config import FusionConfig
from uav_vslam.ros.fleet_commands import feedback_to, packets_of
from uav_vslam.ros.inputs import Input
from uav_vslam.ros.packet_message import decoded, packet_from_msg, packet_to_msg
from uav_vslam.ros.qos import RADIO, compatible_qos
from uav_vslam.ros.vehicle_node import VehicleNode
from uav_vslam.types import LandmarkPacket
from uav_vslam_msgs.msg import LandmarkInformation

if TYPE_CHECKING:  # the link emulator fuses nothing
    from uav_vslam.cooperation.exchange import Receiver

MOST_WAITING = 10  # packets on one topic: a relay sends those of several vehicles while this one may be fusing
OnPacket = Callable[[LandmarkPacket, int], None]  # (packet, serialised size)


@dataclass(slots=True, kw_only=True)
class PeerInput(Input):
    """A subscription on the radio: it requests its mode's QoS, and less where a peer offers less.

    Attributes:
        host: its node.
        wanted: QoS of the mode.
        events: callbacks for events of the middleware.
    """

    host: Node
    wanted: QoSProfile
    events: SubscriptionEventCallbacks
    may_pause: bool = True  # peers come and go; the fusion's status reports them
    shared: bool = True  # whose packets they are, and of which session, the packets say themselves

    @classmethod
    def opened(
        cls,
        host: Node,
        topic: str,
        callback: Callable[[bytes], None],
        wanted: QoSProfile,
        events: SubscriptionEventCallbacks,
    ) -> "PeerInput":
        """Return the subscription of a topic's packets; the arguments are its attributes."""
        one = cls(LandmarkInformation, topic, callback, wanted, topic, host=host, wanted=wanted, events=events)
        one.subscribe(host)
        return one

    def subscribe(self, node: Node) -> None:
        """Create the subscription; it receives serialised bytes, whose number is the size on the radio."""
        self.subscription = self.host.create_subscription(
            self.message_type, self.topic, self._on_message, self.qos, raw=True, event_callbacks=self.events
        )

    def follow(self, node: Node) -> bool:
        """Subscribe again if the publishers' offers require it; return whether they did."""
        offers = [info.qos_profile for info in self.host.get_publishers_info_by_topic(self.subscription.topic_name)]
        asked = compatible_qos(self.wanted, offers)
        if not offers or asked == self.qos:
            return False
        self.qos = asked
        self.renew(node)
        return True

    def renew(self, node: Node) -> None:
        """Subscribe again, on the radio."""
        self.close()
        self.subscribe(node)

    def close(self) -> None:
        """Stop listening."""
        self.host.destroy_subscription(self.subscription)


class Radio:
    """The `cooperation.exchange.Transport` over DDS."""

    def __init__(self, node: VehicleNode, peers: Sequence[str], *, host: Node | None) -> None:
        """Prepare; topics are opened by `tune`.

        Args:
            node: counts what cannot be decoded and what the middleware reports, and watches the inputs.
            peers: names of the other vehicles.
            host: the node of a participant of its own; None: the vehicle's node itself.
        """
        self._node, self._host, self._peers = node, host or node, tuple(peers)
        self._publisher: Any = None
        self._returns: dict[str, Any] = {}  # publishers of feedback, by peer
        self._inputs: list[PeerInput] = []
        self._own_input: PeerInput | None = None  # packets under the own name
        self._receiver: Receiver | None = None
        self._mode = "none"

    def tune(self, settings: FusionConfig, receiver: "Receiver") -> None:
        """Change the communication mode: publishers and subscriptions are replaced, or removed in the mode none."""
        mode = self._mode = settings.mode
        self._receiver = receiver
        self._close()
        self._node.notes["mode"] = mode
        peers = ", ".join(self._peers) or "none (the parameter peers names them)"
        self._node.get_logger().info(f"communication mode: {mode}, peers: {peers}")
        if mode not in RADIO:
            return
        events = PublisherEventCallbacks(**self._counters("deadline", "liveliness", "incompatible_qos"))
        self._publisher = self._advertise(packets_of(self._node.vehicle), mode, event_callbacks=events)
        for peer in self._peers:
            on_packet = partial(receiver.on_packet, peer)
            self._inputs.append(self._listen(peer, packets_of(peer), on_packet, RADIO[mode]))
            self._node.watch(self._inputs[-1])
        if settings.returns_feedback:
            self._returns = {peer: self._advertise(feedback_to(peer), mode) for peer in self._peers}
            self._inputs.append(
                self._listen("feedback", feedback_to(self._node.vehicle), receiver.on_feedback, RADIO[mode])
            )

    @property
    def copies(self) -> int:
        """Transmissions of a packet: DDS sends one to each peer. A shared domain counts as one."""
        if self._host is self._node or not self._publisher:
            return 1
        return max(self._publisher.get_subscription_count() - (self._own_input is not None), 1)

    @property
    def expected_copies(self) -> int:
        """Transmissions of a packet once all peers subscribe, and nobody else."""
        return max(len(self._peers), 1) if self._host is not self._node else 1

    @property
    def now_ns(self) -> int:
        """Time of the computer, which no clock that is set moves, or of a replay [ns]."""
        clock = self._node.get_clock()
        return clock.now().nanoseconds if clock.ros_time_is_active else time.monotonic_ns()

    def look_for_namesake(self) -> None:
        """Listen to the own packets' topic while somebody else publishes it; to be called now and then.

        It may be another vehicle of the same name, or this node before its restart, which its peers' DDS still knows.
        """
        if self._publisher is None or self._receiver is None:
            return
        topic = self._publisher.topic_name
        if self._host.count_publishers(topic) < 2:
            self._close_own_input()
        elif self._own_input is None:
            on_packet = partial(self._receiver.on_packet, self._node.vehicle)
            self._own_input = self._listen("namesake", topic, on_packet, RADIO[self._mode])
        else:
            self._own_input.follow(self._host)

    def send(self, packet: LandmarkPacket, to: Collection[str]) -> None:
        """Publish a packet on the one topic that all peers receive; those that have it already drop it."""
        self._publisher.publish(serialize_message(packet_to_msg(packet)))

    def send_feedback(self, packet: LandmarkPacket, peer: str) -> None:
        """Publish feedback on the topic that only that peer receives."""
        self._returns[peer].publish(serialize_message(packet_to_msg(packet)))

    def _close(self) -> None:
        for one in self._inputs:
            self._node.unwatch(one)
            one.close()
        self._inputs.clear()
        self._close_own_input()
        for publisher in (self._publisher, *self._returns.values()):
            if publisher is not None:
                self._host.destroy_publisher(publisher)
        self._publisher, self._returns = None, {}

    def _close_own_input(self) -> None:
        if self._own_input is not None:
            self._own_input.close()
            self._own_input = None

    def _advertise(self, topic: str, mode: str, **options: Any) -> Any:
        resolved = self._node.resolve_topic_name(topic)
        return self._host.create_publisher(LandmarkInformation, resolved, RADIO[mode], **options)

    def _listen(self, peer: str, name: str, callback: OnPacket, wanted: QoSProfile) -> PeerInput:
        topic = self._node.resolve_topic_name(name)  # remapped if a link is emulated
        wanted = copy.copy(wanted)
        wanted.depth = MOST_WAITING

        def on_bytes(data: bytes) -> None:
            callback(packet_from_msg(decoded(data)), len(data))

        events = self._counters("deadline", "liveliness", "message_lost", "incompatible_qos", "matched", of=peer)
        guarded = self._node.guarded(topic, on_bytes)
        return PeerInput.opened(self._host, topic, guarded, wanted, SubscriptionEventCallbacks(**events))

    def _counters(self, *events: str, of: str = "own") -> dict[str, Callable[[Any], None]]:
        """Return callbacks that count what the middleware reports, for the diagnostics."""

        def count(event: str) -> Callable[[Any], None]:
            def note(status: Any) -> None:
                if event == "matched":  # a peer joins, or its lease has expired
                    self._node.notes[f"radio/{of}/matched"] = str(status.current_count)
                else:
                    self._node.counts[f"radio/{of}/{event}"] += max(getattr(status, "total_count_change", 1), 1)

            return note

        return {event: count(event) for event in events}
