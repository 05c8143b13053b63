# SPDX-License-Identifier: Apache-2.0
"""Subscriptions of a node: which inputs are missing or have stopped, and the QoS that publishers offer.

Camera and IMU drivers often publish best effort, which a reliable subscription never matches; a best-effort one loses
messages of a reliable publisher. So an input starts reliable and switches if only best effort is offered, in flight
too, as a driver that replaces another may offer less. Likewise it asks for what was published before it came, and does
without if nobody offers that; one that does not ask does if nothing comes, as of a latched camera_info. An input that
two nodes publish at once is not used.
"""

import copy
import time
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

from rclpy.callback_groups import CallbackGroup
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.validate_topic_name import validate_topic_name
from sensor_msgs.msg import CompressedImage, Image

from uav_vslam.config.input import COMPRESSED, image_names
from uav_vslam.ros.batches import waiting
from uav_vslam.ros.message_types import type_name
from uav_vslam.ros.publishers import Publishers

STREAM = 10  # messages after which more are expected
PAUSE_S = 5.0  # of a stream before it has stopped,
PAUSE_PERIODS = 10.0  # or so many of its mean periods, whichever is longer


@dataclass(slots=True)
class Input:
    """One subscription.

    Attributes:
        message_type, topic, callback: as given to create_subscription.
        qos: of the current subscription.
        stands_for: topic that it can replace; usually its own.
        raw: the callback gets serialised messages.
        group: of the subscription; None for the node's.
        subscription: the current one.
        received: number of messages.
        may_pause: a pause is not reported.
        shared: several nodes may publish it; of other inputs nothing is used while more than one does.
        once: it is published once, for late joiners.
        publishers: who does.
        refused: number of messages that were not used for that reason.
        first_s, last_s: wall time of the first and the last message.
    """

    message_type: Any
    topic: str
    callback: Callable[[Any], None]
    qos: QoSProfile
    stands_for: str
    raw: bool = False
    group: CallbackGroup | None = None
    subscription: Any = None
    received: int = 0
    may_pause: bool = False
    shared: bool = False
    once: bool = False
    publishers: Publishers = field(default_factory=Publishers)
    refused: int = 0
    first_s: float = 0.0
    last_s: float = 0.0

    def subscribe(self, node: Node) -> None:
        """Create the subscription; its policies can be overridden by parameters qos_overrides.<topic>.subscription."""
        self.qos = copy.copy(self.qos)  # rclpy writes overrides into it, and other topics share the profile
        self._create(node, qos_overriding_options=QoSOverridingOptions.with_default_policies())

    def follow(self, node: Node) -> bool:
        """Resubscribe with less if nothing better is offered, with what was latched if nothing came; return whether."""
        matched, durability = self.subscription.get_publisher_count() > 0, self.qos.durability
        if matched and (self.received or durability != DurabilityPolicy.VOLATILE):
            return False
        published = node.get_publishers_info_by_topic(self.subscription.topic_name)
        offers = [info.qos_profile for info in published if info.topic_type == type_name(self.message_type)]
        if not offers:
            return False
        reliability = self.qos.reliability
        if matched and all(offer.durability == DurabilityPolicy.TRANSIENT_LOCAL for offer in offers):
            durability, self.once = DurabilityPolicy.TRANSIENT_LOCAL, True
        if all(offer.reliability == ReliabilityPolicy.BEST_EFFORT for offer in offers):
            reliability = ReliabilityPolicy.BEST_EFFORT
        # Of many latched publishers, others may come later: they would not be received any more.
        if not self.shared and all(offer.durability == DurabilityPolicy.VOLATILE for offer in offers):
            durability = DurabilityPolicy.VOLATILE
        if (reliability, durability) == (self.qos.reliability, self.qos.durability):
            return False
        self.qos.reliability, self.qos.durability = reliability, durability
        self.renew(node)
        return True

    def renew(self, node: Node) -> None:
        """Subscribe again, which also brings what was published for late joiners."""
        node.destroy_subscription(self.subscription)
        self._create(node)

    def _create(self, node: Node, **options: Any) -> None:
        self.subscription = node.create_subscription(
            self.message_type,
            self.topic,
            self._listener(node),
            self.qos,
            raw=self.raw,
            callback_group=self.group,
            **options,
        )

    def _listener(self, node: Node) -> Callable[..., None]:
        """Return the subscription's callback, which passes on what one publisher sent."""

        def on_message(message: Any, info: Mapping[str, Any]) -> None:
            self.publishers.notice(node, self.subscription)
            self._on_own_message(message, info)

        return self._on_message if self.shared else on_message

    def take_waiting(self, node: Node) -> None:
        """Take the messages that wait, a queue at most; of an input that is not shared."""
        messages = waiting(self.subscription)
        if messages:
            self.publishers.notice(node, self.subscription)  # after all of them: none is of a publisher unknown to it
        for message, info in messages:
            self._on_own_message(message, info)

    def _on_own_message(self, message: Any, info: Mapping[str, Any]) -> None:
        """Pass on a message of an input that one node publishes."""
        self.publishers.received(info["publication_sequence_number"])
        if self.publishers.conflicting:
            self.refused += 1
        else:
            self._on_message(message)

    def _on_message(self, message: Any) -> None:
        self.last_s = time.monotonic()
        self.first_s = self.first_s if self.received else self.last_s
        self.received += 1
        self.callback(message)


def image_topics(node: Node, topic: str) -> dict[type, str]:
    """Return the types and names under which a camera's images may come.

    Remapping the raw topic moves the compressed one with it, as `image_transport` does, unless that is remapped itself.
    """
    validate_topic_name(topic)  # names it; to resolve an impossible one does not
    raw, moved = node.resolve_topic_name(topic), topic
    if raw != node.resolve_topic_name(topic, only_expand=True):
        moved = raw
    topics: dict[type, str] = {}
    for name in image_names(topic):
        remapped = node.resolve_topic_name(name) != node.resolve_topic_name(name, only_expand=True)
        follows = name != topic and not remapped
        topics[CompressedImage if name.endswith(COMPRESSED) else Image] = moved + COMPRESSED if follows else name
    return topics


def mixed(inputs: Iterable[Input], node: Node) -> dict[str, str]:
    """Return the topics of which nothing is used, for more than one node publishes them, and the fault in a line."""
    faults = {}
    for one in inputs:
        if not one.shared:
            one.publishers.look(node, one.subscription)
            if one.publishers.conflicting:
                faults[one.subscription.topic_name] = one.publishers.fault(one.subscription.topic_name)
    return faults


def _substitutes(inputs: Iterable[Input]) -> dict[str, list[Input]]:
    """Return the inputs that can replace each other, by the topic that they stand for."""
    found = defaultdict(list)
    for one in inputs:
        found[one.stands_for].append(one)
    return found


def unmatched(inputs: Iterable[Input]) -> list[str]:
    """Return the topics without a publisher for any subscription that stands for them."""
    return [
        ones[0].subscription.topic_name
        for ones in _substitutes(inputs).values()
        if not any(one.subscription.get_publisher_count() for one in ones)
    ]


def silent(inputs: Iterable[Input]) -> list[str]:
    """Return the topics without any message so far, from themselves or a substitute."""
    return [topic for topic, ones in _substitutes(inputs).items() if not any(one.received for one in ones)]


def mismatch(inputs: Iterable[Input], topic: str, node: Node) -> str:
    """Return why nothing that is published on a topic reaches its inputs: type or QoS, which DDS matches silently."""
    offered, taken = set(), []
    for one in inputs:
        if one.stands_for == topic:
            name, kind = one.subscription.topic_name, type_name(one.message_type)
            published = node.get_publishers_info_by_topic(name)
            offers = [info.qos_profile for info in published if info.topic_type == kind]
            if offers:
                return "" if one.subscription.get_publisher_count() else _qos_apart(one.qos, offers)
            offered |= {info.topic_type for info in published}
            taken.append(kind if name == node.resolve_topic_name(topic) else f"{kind} as {name}")
    return f"published as {' and '.join(sorted(offered))}; it takes {' or '.join(taken)}" if offered else ""


def _qos_apart(wanted: QoSProfile, offers: Iterable[QoSProfile]) -> str:
    offered = {f"{offer.reliability.name}, {offer.durability.name}" for offer in offers}
    needed = f"{wanted.reliability.name}, {wanted.durability.name}"
    return f"published as {' and '.join(sorted(offered))}; it needs {needed}"


def stopped(inputs: Iterable[Input], now_s: float) -> dict[str, float]:
    """Return the topics whose regular stream, their own or a substitute's, has stopped, and for how long [s]."""
    pauses, streams = {}, [one for one in inputs if one.received >= STREAM and not one.may_pause]
    for topic, ones in _substitutes(streams).items():
        last = max(ones, key=lambda one: one.last_s)
        period_s = (last.last_s - last.first_s) / (last.received - 1)
        if now_s - last.last_s > max(PAUSE_S, PAUSE_PERIODS * period_s):
            pauses[topic] = now_s - last.last_s
    return pauses
