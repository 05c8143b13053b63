# SPDX-License-Identifier: Apache-2.0
"""Discovery state of the fleet's nodes: each reports its own, and the replay waits for all, so that its first frame is
not lost.
"""

from collections.abc import Callable, Sequence

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node

from uav_vslam.ros.diagnostics import status_message
from uav_vslam.ros.timers import create_wall_timer

DISCOVERY = "/discovery"  # apart from /diagnostics, which is for the operator
PERIOD_S = 1.0
UNMATCHED = "unmatched"  # key: subscriptions without a publisher so far
READERS = "readers"  # key: matched subscriptions of each output, "topic=count ..."
FLEET = "fleet"  # nodes in no vehicle's namespace
SERVING = ("recorder", "link_emulator")  # nodes of the fleet that a replay waits for
UNNAMED = "_NODE_NAMESPACE_UNKNOWN_"  # namespace that the middleware gives to an endpoint of a node not yet discovered


class DiscoveryReport:
    """A node's reports about its inputs and outputs, as long as somebody reads them."""

    def __init__(self, node: Node, unmatched: Callable[[], list[str]]) -> None:
        """Report for `node`; `unmatched` returns its inputs without a publisher so far."""
        self._node, self._unmatched = node, unmatched
        self._publisher = node.create_publisher(DiagnosticArray, DISCOVERY, 10)
        create_wall_timer(node, PERIOD_S, self._report)

    def _report(self) -> None:
        if not self._publisher.get_subscription_count():
            return
        values = {
            UNMATCHED: " ".join(self._unmatched()),
            READERS: " ".join(f"{p.topic_name}={p.get_subscription_count()}" for p in self._node.publishers),
        }
        name = f"{_owner(self._node.get_namespace())}: {self._node.get_name()}"
        self._publisher.publish(status_message(name, values))


class Readiness:
    """Evaluates what the nodes report about their own inputs and outputs.

    Discovery is one-sided: a subscription gets nothing before it has discovered the publisher, nor does it get messages
    that were published before the publisher discovered it.
    """

    def __init__(self, node: Node, vehicles: Sequence[str]) -> None:
        """Subscribe by `node`; wait for the nodes of `vehicles` and those that serve the fleet."""
        self._node, self._vehicles = node, tuple(vehicles)
        self._unmatched: dict[str, list[str]] = {}
        self._readers: dict[str, dict[str, int]] = {}
        node.create_subscription(DiagnosticArray, DISCOVERY, self._on_report, 100)

    def missing(self) -> list[str]:
        """Return descriptions of the missing connections."""
        unreported = [f"{name} has not reported" for name in self._expected() if name not in self._unmatched]
        undiscovered_publishers = [
            f"{name} has not found the publisher of {topic}"
            for name, topics in self._unmatched.items()
            for topic in topics
            if self._node.count_publishers(topic)
        ]
        undiscovered_subscribers = [
            f"{name} has not found every reader of {topic}"
            for name, counts in self._readers.items()
            for topic, count in counts.items()
            if self._node.count_subscribers(topic) > count
        ]
        return unreported + undiscovered_publishers + undiscovered_subscribers

    def _expected(self) -> list[str]:
        infos = self._node.get_publishers_info_by_topic(DISCOVERY)
        found = [(_owner(info.node_namespace), info.node_name) for info in infos]
        return [
            f"{owner}: {name}"
            for owner, name in found
            if owner in self._vehicles or owner == UNNAMED or (owner == FLEET and name in SERVING)
        ]

    def _on_report(self, message: DiagnosticArray) -> None:
        for status in message.status:
            for entry in status.values:
                if entry.key == UNMATCHED:
                    self._unmatched[status.name] = entry.value.split()
                elif entry.key == READERS:
                    pairs = (item.rpartition("=") for item in entry.value.split())
                    self._readers[status.name] = {topic: int(count) for topic, _, count in pairs}


def _owner(namespace: str) -> str:
    return namespace.strip("/") or FLEET
