# SPDX-License-Identifier: Apache-2.0
"""Messages of fast topics, taken in batches.

rclpy's executor builds its wait set anew at each turn, and each callback costs it two turns: for a topic of 200 Hz far
more than the callback itself. Taking the messages that wait costs a fraction of that.
"""

from typing import Any

from rclpy.callback_groups import CallbackGroup


class Batches(CallbackGroup):
    """Subscriptions of this group don't wake the executor: somebody takes their messages by `take_waiting`.

    Attributes:
        at_once: they do wake it, as usual.
    """

    def __init__(self, *, at_once: bool) -> None:
        super().__init__()
        self.at_once = at_once

    def can_execute(self, entity: Any) -> bool:
        """Events of a subscription wait too: its messages would wake those who wait for its events."""
        return self.at_once

    def beginning_execution(self, entity: Any) -> bool:
        """Allow it: all callbacks run in one thread."""
        return True

    def ending_execution(self, entity: Any) -> None:
        """Nothing to do."""


def take_waiting(subscription: Any) -> None:
    """Call back with each message that waits, a queue at most; the callback takes the message and its info."""
    with subscription.handle:
        for _ in range(subscription.qos_profile.depth):
            taken = subscription.handle.take_message(subscription.msg_type, subscription.raw)
            if taken is None:
                return
            subscription.callback(*taken)
