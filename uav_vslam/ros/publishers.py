# SPDX-License-Identifier: Apache-2.0
"""Whether an input that one node should publish is published by two: nothing else would show that their data are mixed.

Nodes of different names are two. Those of one name may be a process that died and the one that took its place, for DDS
forgets a dead one only when its lease expires (20 s); or they are two vehicles of one name. Their messages show which:
every publisher numbers its own, so of n publishers that came one after the other, the number falls n - 1 times at most.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from rclpy.node import Node

UNKNOWN = "_NODE_NAME_UNKNOWN_"  # of a publisher whose node has not been discovered yet
NO_NUMBER = 2**64 - 1  # of messages of a middleware that doesn't number them


@dataclass(slots=True)
class Publishers:
    """The publishers that one subscription is matched with.

    Attributes:
        names: their nodes, one entry a publisher.
        conflicting: the same when more than one was alive; empty if that was before the last look but one, for messages
            of one that has left may still wait.
    """

    names: tuple[str, ...] = ()
    conflicting: tuple[str, ...] = ()
    _count: int = 0
    _were_several: bool = False
    _falls: int = 0
    _number: int = -1

    @property
    def several(self) -> bool:
        """Whether more than one is alive."""
        known = {name for name in self.names if UNKNOWN not in name}
        return len(self.names) > 1 and (len(known) > 1 or self._falls >= len(self.names))

    def look(self, node: Node, subscription: Any) -> None:
        """Find out who they are; to be called now and then."""
        self.notice(node, subscription)
        if self.several:
            self.conflicting = self.names
        elif not self._were_several:
            self.conflicting = ()
        self._were_several = self.several

    def notice(self, node: Node, subscription: Any) -> None:
        """Find out who they are if one has come or gone; cheap enough for each message."""
        count = subscription.get_publisher_count()
        if count != self._count or (count > 1 and any(UNKNOWN in name for name in self.names)):
            found = nodes_publishing(node, subscription.topic_name) if count > 1 else []
            self.set([*found, *[UNKNOWN] * (count - len(found))])
            self._count = count

    def set(self, names: Sequence[str]) -> None:
        """Record who they are now; one that is gone takes along the fall of the number that its successor made."""
        gone = max(len(self.names) - len(names), 0)
        self._falls = max(self._falls - gone, 0) if len(names) > 1 else 0
        self.names = tuple(names)

    def received(self, number: int) -> None:
        """Record the number that a message has from its publisher."""
        if number != NO_NUMBER:
            self._falls += len(self.names) > 1 and number <= self._number
            self._number = number
        if self.several:
            self.conflicting = self.names

    def fault(self, topic: str) -> str:
        """Return what is wrong, in a line."""
        is_one_name = len(set(self.conflicting)) == 1
        cause = "it was started twice, or two vehicles have one name" if is_one_name else "end all but one"
        nodes = ", ".join(self.conflicting)
        return f"{len(self.conflicting)} nodes publish {topic}: {nodes}; it is not used until one is left ({cause})"


def nodes_publishing(node: Node, topic: str) -> list[str]:
    """Return the full names of the nodes that publish a topic, one a publisher."""
    found = node.get_publishers_info_by_topic(topic)
    return sorted(f"{info.node_namespace.rstrip('/')}/{info.node_name}" for info in found)
