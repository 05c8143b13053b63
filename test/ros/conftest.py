# SPDX-License-Identifier: Apache-2.0
from collections.abc import Iterator
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from rclpy.node import Node


@pytest.fixture
def listener(domain_id: int) -> "Iterator[Node]":
    """A plain node, in a context of its own."""
    rclpy = pytest.importorskip("rclpy", reason="needs ROS")
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=domain_id)
    node = rclpy.create_node("listener", context=context)
    yield node
    node.destroy_node()
    rclpy.shutdown(context=context)
