# SPDX-License-Identifier: Apache-2.0
"""Timers on wall time, which go on while the ROS clock of a replay stands still."""

from collections.abc import Callable

from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.timer import Timer


def create_wall_timer(node: Node, period_s: float, callback: Callable[[], None]) -> Timer:
    """Call `callback` every `period_s` seconds of a steady clock."""
    return node.create_timer(period_s, callback, clock=Clock(clock_type=ClockType.STEADY_TIME))
