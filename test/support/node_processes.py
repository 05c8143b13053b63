# SPDX-License-Identifier: Apache-2.0
"""Nodes as processes, and a node of the test's own that hears what they report."""

import contextlib
import os
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.executors import SingleThreadedExecutor

from uav_vslam.ros.command import node_command
from uav_vslam.ros.fleet_commands import NodeSpec
from waiting import wait_for


@contextlib.contextmanager
def running(
    specs: list[NodeSpec], folder: Path, domain_id: int, **options: Any
) -> Iterator[dict[str, subprocess.Popen[bytes]]]:
    """Run nodes as processes, with their output in files; none outlives the test."""
    environment, found = os.environ | {"ROS_DOMAIN_ID": str(domain_id), "PYTHONFAULTHANDLER": "1"}, {}
    try:
        for spec in specs:
            with (folder / f"{spec.executable}.log").open("wb") as log:
                argv = node_command(spec).argv
                found[spec.executable] = subprocess.Popen(
                    argv, env=environment | spec.environment, stdout=log, stderr=subprocess.STDOUT, **options
                )
        yield found
    finally:
        for process in found.values():
            process.kill()
            process.wait()


class Witness:
    """A node in the test's process, on the domain of the nodes that it watches.

    Attributes:
        node: to publish with.
        statuses: newest status of each node, as in "uav1: fusion".
    """

    def __init__(self, domain_id: int, *, name: str = "witness") -> None:
        self._context = rclpy.Context()
        self._context.init(domain_id=domain_id)
        self.node = rclpy.create_node(name, context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)
        self.statuses: dict[str, DiagnosticStatus] = {}
        self.node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 100)

    def __enter__(self) -> "Witness":
        return self

    def __exit__(self, *_: object) -> None:
        self._executor.shutdown()
        self.node.destroy_node()
        self._context.try_shutdown()

    def sees(self, condition: Callable[[], Any], step: Callable[[], Any] = lambda: None) -> bool:
        """Spin, taking steps, until the condition holds; return whether it does."""

        def turn() -> None:
            step()
            self.turn()

        return wait_for(condition, turn)

    def turn(self) -> None:
        """Handle what has arrived."""
        self._executor.spin_once(timeout_sec=0.02)

    def is_error(self, name: str) -> bool:
        """Whether a node reports an ERROR."""
        return name in self.statuses and self.statuses[name].level == DiagnosticStatus.ERROR

    def text(self, name: str) -> str:
        """Message of a node's status, or nothing before the first."""
        return self.statuses[name].message if name in self.statuses else ""

    def value(self, name: str, key: str) -> str:
        """Return a value of a node's status, or nothing if it has none."""
        found = self.statuses[name].values if name in self.statuses else []
        return next((str(entry.value) for entry in found if entry.key == key), "")

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        self.statuses |= {status.name: status for status in message.status}
