# SPDX-License-Identifier: Apache-2.0
import signal
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


@pytest.fixture
def hangup() -> Iterator[None]:
    """SIGHUP ends what a test starts, also where the tests themselves run under `nohup`."""
    before = signal.signal(signal.SIGHUP, signal.SIG_DFL)
    yield
    signal.signal(signal.SIGHUP, before)
