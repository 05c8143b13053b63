# SPDX-License-Identifier: Apache-2.0
"""Lists, prints and measures live topics; for `uav-vslam topic`."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import rclpy
from rclpy.exceptions import InvalidTopicNameException
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.validate_full_topic_name import validate_full_topic_name

from uav_vslam.errors import UavVslamError
from uav_vslam.ros.domain import check_domain
from uav_vslam.ros.leaving import leaving
from uav_vslam.ros.log_folder import log_folder
from uav_vslam.ros.message_types import type_named

LONGEST = 8  # elements of an array that are printed
SPIN_S = 0.1


class Observer(Node):
    """A node that serves nobody; whoever uses it spins it."""

    def __init__(self, context: rclpy.Context, name: str) -> None:
        super().__init__(name, context=context, start_parameter_services=False, enable_rosout=False)
        self._executor = SingleThreadedExecutor(context=context)
        self._executor.add_node(self)

    def spin_until(self, done: Callable[[], bool], timeout_s: float = float("inf")) -> bool:
        """Spin until a condition holds; return whether it did before the timeout."""
        end_s = time.monotonic() + timeout_s
        while not done():
            left_s = end_s - time.monotonic()
            if left_s <= 0.0:
                return False
            self._executor.spin_once(timeout_sec=min(SPIN_S, left_s))
        return True


@contextmanager
def observer(domain_id: int | None, name: str = "uav_vslam_topic") -> Iterator[Observer]:
    """Join a ROS domain as an observer of that node name.

    Raises:
        ConfigError: no ROS domain has that number, or ROS can't keep its logs.
    """
    check_domain(domain_id)
    context = rclpy.Context()
    with log_folder():
        context.init(domain_id=domain_id)
    node = Observer(context, name)
    try:
        yield node
    finally:
        with leaving():
            node.destroy_node()
            context.try_shutdown()


def print_topics(node: Observer, *, wait_s: float) -> None:
    """Print every topic with its type."""
    node.spin_until(lambda: False, wait_s)
    for topic, types in sorted(node.get_topic_names_and_types()):
        print(f"{topic}  [{', '.join(types)}]")


def echo(node: Observer, topic: str, *, wait_s: float, count: int) -> None:
    """Print `count` messages of a topic, or (0) without end."""
    printed: list[None] = []

    def show(message: Any) -> None:
        print("\n".join(format_message(message)), "---", sep="\n", flush=True)
        printed.append(None)

    _subscribe(node, topic, show, wait_s=wait_s, rate=False)
    node.spin_until(lambda: 0 < count <= len(printed))


def print_rate(node: Observer, topic: str, *, wait_s: float, count: int) -> None:
    """Print a topic's rate and bandwidth once a second, `count` times or (0) without end."""
    sizes: list[int] = []
    _subscribe(node, topic, lambda data: sizes.append(len(data)), wait_s=wait_s, rate=True)
    reports = 0
    while not count or reports < count:
        begin_s = time.monotonic()
        sizes.clear()
        node.spin_until(lambda: False, 1.0)
        elapsed_s = time.monotonic() - begin_s
        print(f"{len(sizes) / elapsed_s:.2f} Hz, {sum(sizes) / elapsed_s / 1e3:.2f} kB/s", flush=True)
        reports += 1


def format_message(message: Any, indent: str = "") -> list[str]:
    """Return a message as indented lines; arrays longer than `LONGEST` are truncated, with their length."""
    lines = []
    for name in message.get_fields_and_field_types():
        lines += _format_value(name, getattr(message, name), indent)
    return lines


def _format_value(name: str, value: Any, indent: str) -> list[str]:
    if hasattr(value, "get_fields_and_field_types"):
        return [f"{indent}{name}:", *format_message(value, indent + "  ")]
    if isinstance(value, str | bytes) or not hasattr(value, "__len__"):
        return [f"{indent}{name}: {value!r}" if isinstance(value, str) else f"{indent}{name}: {value}"]
    rest = f" ... {len(value)} in all" if len(value) > LONGEST else ""
    head = list(value[:LONGEST])
    if head and hasattr(head[0], "get_fields_and_field_types"):
        items = [line for item in head for line in (f"{indent}-", *format_message(item, indent + "  "))]
        return [f"{indent}{name}:{rest}", *items]
    return [f"{indent}{name}: [{', '.join(_format_scalar(item) for item in head)}]{rest}"]


def _format_scalar(value: Any) -> str:
    number = value.item() if isinstance(value, np.generic) else value  # of an array of a fixed size
    return f"{number:.6g}" if isinstance(number, float) else repr(number)


def _subscribe(node: Observer, topic: str, callback: Callable[[Any], None], *, wait_s: float, rate: bool) -> None:
    """Subscribe with the QoS that the publishers offer; for a rate to serialised messages, and without earlier ones.

    Raises:
        UavVslamError: no topic can have that name, or it has no publisher, or its type is not installed.
    """
    absolute = topic if topic.startswith("/") else f"/{topic}"
    try:
        validate_full_topic_name(absolute)
    except InvalidTopicNameException as error:
        reason = str(error).splitlines()[0].removeprefix("Invalid topic name: ").rstrip(":")
        raise UavVslamError(f"{topic!r} is no topic: {reason}") from None
    if not node.spin_until(lambda: node.count_publishers(absolute) > 0, wait_s):
        raise UavVslamError(f"{absolute}: no publisher; see `uav-vslam topic list` and check ROS_DOMAIN_ID")
    offers = [info.qos_profile for info in node.get_publishers_info_by_topic(absolute)]
    reliable = all(offer.reliability == ReliabilityPolicy.RELIABLE for offer in offers)
    latched = not rate and all(offer.durability == DurabilityPolicy.TRANSIENT_LOCAL for offer in offers)
    qos = QoSProfile(
        depth=100,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )
    name = dict(node.get_topic_names_and_types())[absolute][0]
    node.create_subscription(type_named(name, topic=absolute), absolute, callback, qos, raw=rate)
