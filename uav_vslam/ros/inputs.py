# SPDX-License-Identifier: Apache-2.0
"""Subscriptions of a node: which inputs are missing or have stopped, and the reliability that publishers offer.

Camera and IMU drivers often publish best effort, and a reliable subscription would never match them; a best-effort one
would lose messages of a reliable publisher. So an input starts reliable and follows if only best effort is offered.
"""

import time
from collections import defaultdict
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions

STREAM = 10  # messages after which more are expected
PAUSE_S = 5.0  # of a stream before it has stopped,
PAUSE_PERIODS = 10.0  # or so many of its mean periods, whichever is longer


@dataclass(slots=True)
class Input:
    """One subscription.

    Attributes:
        message_type, topic, callback, qos: as given to create_subscription.
        stands_for: topic whose absence it makes good; its own as a rule.
        subscription: the live one.
        heard: messages that have come.
        may_pause: that no more come is nothing to report.
        first_s, last_s: wall time of the first and the last message.
    """

    message_type: Any
    topic: str
    callback: Callable[[Any], None]
    qos: QoSProfile
    stands_for: str
    subscription: Any = None
    heard: int = 0
    may_pause: bool = False
    first_s: float = 0.0
    last_s: float = 0.0

    def subscribe(self, node: Node) -> None:
        """Create the subscription; its policies can be overridden by parameters qos_overrides.<topic>.subscription."""
        overrides = QoSOverridingOptions.with_default_policies()
        self.subscription = node.create_subscription(
            self.message_type, self.topic, self._on_message, self.qos, qos_overriding_options=overrides
        )

    def follow(self, node: Node) -> bool:
        """Subscribe again as best effort where nothing else is offered; tell whether that was so."""
        if self.heard or self.qos.reliability != ReliabilityPolicy.RELIABLE:
            return False
        offers = node.get_publishers_info_by_topic(self.subscription.topic_name)
        if not offers or any(o.qos_profile.reliability != ReliabilityPolicy.BEST_EFFORT for o in offers):
            return False
        node.destroy_subscription(self.subscription)
        self.qos = QoSProfile(depth=self.qos.depth, reliability=ReliabilityPolicy.BEST_EFFORT)
        self.subscription = node.create_subscription(self.message_type, self.topic, self._on_message, self.qos)
        return True

    def _on_message(self, message: Any) -> None:
        self.last_s = time.monotonic()
        self.first_s = self.first_s if self.heard else self.last_s
        self.heard += 1
        self.callback(message)


def unmatched(inputs: Iterable[Input]) -> list[str]:
    """Return the topics that no subscription standing for them has found a publisher of."""
    found: dict[str, bool] = {}
    names: dict[str, str] = {}
    for one in inputs:
        found[one.stands_for] = found.get(one.stands_for, False) or one.subscription.get_publisher_count() > 0
        names.setdefault(one.stands_for, one.subscription.topic_name)
    return [names[topic] for topic, matched in found.items() if not matched]


def silent(inputs: Iterable[Input]) -> list[str]:
    """Return the topics from which nothing has come, neither by themselves nor by a stand-in."""
    heard: dict[str, bool] = {}
    for one in inputs:
        heard[one.stands_for] = heard.get(one.stands_for, False) or one.heard > 0
    return [topic for topic, came in heard.items() if not came]


def stopped(inputs: Iterable[Input], now_s: float) -> dict[str, float]:
    """Return the topics that spoke regularly, by themselves or by a stand-in, and no longer do: for how long [s]."""
    streams = defaultdict(list)
    for one in inputs:
        if one.heard >= STREAM and not one.may_pause:
            streams[one.stands_for].append(one)
    pauses = {}
    for topic, ones in streams.items():
        last = max(ones, key=lambda one: one.last_s)
        period_s = (last.last_s - last.first_s) / (last.heard - 1)
        if now_s - last.last_s > max(PAUSE_S, PAUSE_PERIODS * period_s):
            pauses[topic] = now_s - last.last_s
    return pauses
