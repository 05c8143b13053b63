# SPDX-License-Identifier: Apache-2.0
"""Nodes of uav1 in the test's process; without their graph, inputs go to their callbacks directly."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Protocol, TypeVar

import rclpy
from rclpy.serialization import serialize_message

from uav_vslam.ros.runtime import finish
from uav_vslam.ros.vehicle_node import VehicleNode


class Destroyable(Protocol):
    """A node, or several."""

    def destroy_node(self) -> None:
        """Destroy it, or them."""


Node = TypeVar("Node", bound=Destroyable)


@contextmanager
def lone_node(kind: Callable[[], Node], domain_id: int) -> Iterator[Callable[..., Node]]:
    """Give a function that makes the node with parameters `name:=value`."""
    nodes = []

    def made(*parameters: str) -> Node:
        arguments = ["--ros-args", "-r", "__ns:=/uav1", *(part for p in parameters for part in ("-p", p))]
        rclpy.init(args=arguments, domain_id=domain_id)
        nodes.append(kind())
        return nodes[-1]

    try:
        yield made
    finally:
        for node in nodes:
            finish(node)
            node.destroy_node()
        rclpy.shutdown()


def deliver(node: VehicleNode, topic: str, message: object) -> None:
    """Call back with a message, as if it came on the topic."""
    (one,) = (one for one in node._inputs if one.topic == topic and isinstance(message, one.message_type))
    one.callback(serialize_message(message) if one.raw else message)
