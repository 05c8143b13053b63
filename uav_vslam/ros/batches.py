# SPDX-License-Identifier: Apache-2.0
"""Messages, taken from their subscriptions by whoever wants them.

A turn of an executor costs more than a short callback: for a topic of 200 Hz, taking the messages that wait, now and
then, costs a fraction of a turn for each.
"""

from contextlib import suppress
from typing import Any

from rclpy.callback_groups import CallbackGroup
from rclpy.exceptions import InvalidHandle
from rclpy.subscription import Subscription


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


def waiting(subscription: Any, most: int | None = None) -> list[tuple[Any, Any]]:
    """Take the messages that wait, each with its info; none if the subscription has been destroyed.

    Args:
        subscription: of rclpy.
        most: no more than these; None for its queue.
    """
    messages: list[tuple[Any, Any]] = []
    with suppress(InvalidHandle), subscription.handle:
        take, kind, raw = subscription.handle.take_message, subscription.msg_type, subscription.raw
        for _ in range(most or subscription.qos_profile.depth):
            taken = take(kind, raw)
            if taken is None:
                break
            messages.append(taken)
    return messages


def take_waiting(subscription: Any, most: int | None = None) -> None:
    """Call back with the messages that `waiting` returns."""
    with_info = subscription._callback_type is Subscription.CallbackType.WithMessageInfo
    for taken in waiting(subscription, most):
        subscription.callback(*taken if with_info else taken[:1])
