# SPDX-License-Identifier: Apache-2.0
"""Packets out and in: what the fusion core makes, over the radio within the budget; what peers send, to its inbox."""

from collections import Counter
from collections.abc import Sequence

from rclpy.node import Node
from rclpy.serialization import serialize_message

from uav_vslam.config import FusionConfig
from uav_vslam.cooperation.fusion import Fusion
from uav_vslam.cooperation.outbox import Outbox
from uav_vslam.errors import InvalidMessage
from uav_vslam.ros.packet_message import packet_from_msg, packet_to_msg
from uav_vslam.ros.radio import Radio
from uav_vslam.ros.runtime import VehicleNode
from uav_vslam.types import JointInformation
from uav_vslam_msgs.msg import LandmarkInformation


class PacketExchange:
    """A vehicle's part in the exchange of packets, in one communication mode at a time.

    Attributes:
        settings: at present.
        outbox: what was sent and held back.
        received_bytes: serialised size of all packets that came, by peer.
    """

    def __init__(self, node: VehicleNode, fusion: Fusion, peers: Sequence[str], *, host: Node | None) -> None:
        """Prepare; nothing is opened before `configure`.

        Args:
            node: counts what is dropped.
            fusion: makes packets and takes those of the peers.
            peers: names of the other vehicles.
            host: the node of a participant of the radio's own; None: the vehicle's node itself.
        """
        self._node, self._fusion, self._peers = node, fusion, tuple(peers)
        self._vehicles = {node.vehicle, *peers}
        self._radio = Radio(node, peers, self._on_packet, self._on_feedback, host=host)
        self.settings: FusionConfig = node.config.fusion
        self.outbox = Outbox(self.settings)
        self.received_bytes: Counter[str] = Counter()
        self._tuned: tuple[str, bool] | None = None  # mode, and whether feedback is sent

    def configure(self, settings: FusionConfig) -> None:
        """Begin, or go on with other settings; the radio is opened again where its topics change."""
        self.settings = settings
        self._fusion.configure(settings)
        self.outbox.configure(settings, copies=self._radio.expected_copies)
        tuned = settings.mode, settings.returns_feedback
        if tuned == self._tuned:
            return
        self._tuned = tuned
        self._radio.tune(settings.mode, feedback=settings.returns_feedback)
        self._node.notes["mode"] = settings.mode
        self._node.get_logger().info(f"communication mode: {settings.mode}")

    def send(self, joint: JointInformation) -> None:
        """Send an epoch's packet, unless the budget has no room for it: then the next epoch's replaces it."""
        copies = self._radio.copies
        if not self.outbox.should_send(joint.stamp_ns, copies=copies):
            return
        left = self.outbox.available(joint.stamp_ns) // copies
        packet = self._fusion.packet(joint, byte_limit=left)
        data = serialize_message(packet_to_msg(packet))
        if self.outbox.try_reserve(packet.stamp_ns, len(data) * copies):
            self._radio.send(data)
        else:
            detail = f"packet {packet.sequence} of {len(data)} B is not sent: the budget has {left} B a peer left"
            self._node.drop("budget", detail)
        if self.settings.returns_feedback:
            self._give_back(joint.stamp_ns)

    def _give_back(self, stamp_ns: int) -> None:
        """Tell each peer what fusion made of its landmarks, as far as the budget goes."""
        for peer in self._peers:
            feedback = self._fusion.feedback(peer)
            data = serialize_message(packet_to_msg(feedback)) if feedback else b""
            if data and self.outbox.try_reserve(stamp_ns, len(data)):
                self._radio.give_back(peer, data)

    def _on_packet(self, peer: str, message: LandmarkInformation, data: bytes) -> None:
        """Take a packet in; a peer may send on those of others, as they came."""
        self.received_bytes[peer] += len(data)
        if message.vehicle != peer and message.vehicle not in self._vehicles:
            raise InvalidMessage("sender", f"{peer}'s topic carries a packet of {message.vehicle!r}")
        packet = packet_from_msg(message)
        if packet.other_sources:
            raise InvalidMessage("sources", f"{packet.source} sends feedback where packets are expected")
        try:
            self._fusion.inbox.add(packet)
        except InvalidMessage:
            if message.vehicle == peer:
                raise
            return  # what is sent on often comes twice, or comes home; the inbox counts it
        self.outbox.on_packet(packet.stamp_ns)
        now_ns = self.outbox.now_ns  # a peer's own stamp may be wrong
        if self.settings.relay and self.outbox.try_reserve(now_ns, len(data) * self._radio.copies):
            self._radio.send(data)

    def _on_feedback(self, _: str, message: LandmarkInformation, data: bytes) -> None:
        if message.vehicle not in self._peers:
            raise InvalidMessage("sender", f"feedback comes from {message.vehicle!r}")
        self.received_bytes[message.vehicle] += len(data)
        packet = packet_from_msg(message)
        self._fusion.returned.add(packet)
        self.outbox.on_packet(packet.stamp_ns)
