# SPDX-License-Identifier: Apache-2.0
"""link_emulator: an impaired radio between the vehicles of one host: delay, loss, duplication and reordering.

in   /<sender>/landmark_information        uav_vslam_msgs/LandmarkInformation of every vehicle
     /<receiver>/fusion/feedback           the same type, peers' fused estimates of its landmarks
out  /<receiver>/received/<sender>         the same bytes, as delivered by the link
     /<receiver>/received/feedback         likewise
     /diagnostics                          fate of the packets, by direction

A receiver uses it if its fusion node's /<sender>/landmark_information is remapped to /<receiver>/received/<sender>,
and fusion/feedback to /<receiver>/received/feedback.
Time is the ROS clock, so that the link is the same at any replay rate.
"""

from collections.abc import Callable
from functools import partial
from itertools import permutations
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node

from uav_vslam.config.nodes import LinkNodeConfig
from uav_vslam.cooperation.link import Link, link_between
from uav_vslam.errors import ConfigError, InvalidMessage
from uav_vslam.monitor import DROPPED
from uav_vslam.ros.diagnostics import status_message
from uav_vslam.ros.fleet_commands import feedback_to, link_output, packets_of
from uav_vslam.ros.inputs import unmatched
from uav_vslam.ros.packet_message import decoded
from uav_vslam.ros.params import declare, read
from uav_vslam.ros.qos import RADIO
from uav_vslam.ros.radio import PeerInput
from uav_vslam.ros.readiness import DiscoveryReport
from uav_vslam.ros.runtime import run_node
from uav_vslam.ros.timers import create_wall_timer
from uav_vslam.ros.vehicle_node import FOLLOW_PERIOD_S
from uav_vslam_msgs.msg import LandmarkInformation

POLL_S = 0.01  # largest additional delay
REPORT_S = 1.0


class LinkEmulatorNode(Node):
    """Relays bytes through one `Link` a direction."""

    def __init__(self) -> None:
        super().__init__("link_emulator")
        own = read(self, LinkNodeConfig)
        declare(self, own)
        vehicles, config = own.vehicles, own.link
        if len(vehicles) < 2:
            raise ConfigError("link_emulator: set the parameter vehicles (two names or more)")
        self._links: dict[tuple[str, str], Link[tuple[Any, bytes]]] = {  # of (output publisher, bytes)
            (sender, receiver): link_between(config, sender, receiver) for sender, receiver in permutations(vehicles, 2)
        }
        self._outputs = {
            (sender, receiver): self.create_publisher(
                LandmarkInformation, link_output(receiver, sender), RADIO["wideband"]
            )
            for sender, receiver in self._links
        }
        self._returns = {
            receiver: self.create_publisher(LandmarkInformation, link_output(receiver, "feedback"), RADIO["wideband"])
            for receiver in vehicles
        }
        self._inputs = [self._listen(packets_of(name), partial(self._on_packet, name)) for name in vehicles]
        self._inputs += [self._listen(feedback_to(name), partial(self._on_feedback, name)) for name in vehicles]
        self._undecodable = 0  # messages of feedback that show no sender
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        DiscoveryReport(self, lambda: unmatched(self._inputs))
        create_wall_timer(self, POLL_S, self._deliver)
        create_wall_timer(self, FOLLOW_PERIOD_S, self._follow)
        create_wall_timer(self, REPORT_S, self._report)
        self.get_logger().info(f"{len(self._links)} links: {config}")

    def _listen(self, topic: str, callback: Callable[[bytes], None]) -> PeerInput:
        events = SubscriptionEventCallbacks(incompatible_qos=lambda _: None)  # handled by `follow`
        return PeerInput.opened(self, topic, callback, RADIO["wideband"], events)

    def _on_packet(self, sender: str, data: bytes) -> None:
        now_ns = self.get_clock().now().nanoseconds
        for direction, link in self._links.items():
            if direction[0] == sender:
                link.send(now_ns, len(data), (self._outputs[direction], data))

    def _on_feedback(self, receiver: str, data: bytes) -> None:
        try:
            sender = decoded(data).vehicle
        except InvalidMessage as error:
            self._undecodable += 1
            self.get_logger().warning(f"dropped feedback to {receiver}: {error}", throttle_duration_sec=5.0)
            return
        link = self._links.get((sender, receiver))
        if link is not None:
            link.send(self.get_clock().now().nanoseconds, len(data), (self._returns[receiver], data))

    def _deliver(self) -> None:
        now_ns = self.get_clock().now().nanoseconds
        for link in self._links.values():
            for output, data in link.receive(now_ns):
                output.publish(data)

    def _follow(self) -> None:
        for one in self._inputs:
            one.follow(self)

    def _report(self) -> None:
        values = {DROPPED + "undecodable": str(self._undecodable)} if self._undecodable else {}
        for (sender, receiver), link in self._links.items():
            for fate, count in sorted(link.packets.items()):
                values[f"{sender}>{receiver}/{fate}"] = f"{count} packets, {link.size_bytes[fate]} B"
            values[f"{sender}>{receiver}/queued"] = f"{link.queued_bytes} B"
        stamp = self.get_clock().now().to_msg()
        self._diagnostics.publish(status_message("fleet: link_emulator", values, text="relaying", stamp=stamp))


def main(args: list[str] | None = None) -> int:
    """Entry point."""
    return run_node(LinkEmulatorNode, args)


if __name__ == "__main__":
    raise SystemExit(main())
