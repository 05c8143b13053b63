# SPDX-License-Identifier: Apache-2.0
"""A process to run, and the one that runs a node; imports no ROS."""

import os
import sys
from dataclasses import dataclass, field
from pathlib import Path

from uav_vslam.ros.fleet_commands import NodeSpec

PACKAGE = "uav_vslam"


@dataclass(frozen=True, slots=True)
class Command:
    """One process to run.

    Attributes:
        name: prefix of its output.
        argv: program and arguments.
        leads: its exit shuts down the fleet; otherwise only a signal or a failure does.
        environment: variables in addition to the supervisor's.
        resume: further arguments of a process that takes the place of one that failed.
        optional: the fleet goes on without it if it fails, unless its input is wrong.
    """

    name: str
    argv: list[str]
    leads: bool = False
    environment: dict[str, str] = field(default_factory=dict)
    resume: tuple[str, ...] = ()
    optional: bool = False


def node_command(spec: NodeSpec, log_level: str = "") -> Command:
    """Return the command that runs a node; its name is "uav1/slam_backend", or "replay" for the whole fleet."""
    name = f"{spec.namespace}/{spec.executable}".strip("/")
    argv = [*find_executable(spec.executable), *spec.ros_arguments()]
    argv += ["--log-level", log_level] if log_level else []
    resume = () if spec.namespace == "/" else ("-p", "resume:=true")
    leads, optional = spec.executable == "replay", spec.executable == "recorder"
    return Command(name, argv, leads, spec.environment, resume, optional)


def find_executable(name: str) -> list[str]:
    """Return the start command of a node: the installed program as for `ros2 run`, or the module itself."""
    prefixes = os.environ.get("AMENT_PREFIX_PATH", "").split(":")
    installed = [Path(prefix) / "lib" / PACKAGE for prefix in prefixes if prefix]
    for folder in (*installed, Path(sys.argv[0]).resolve().parent):
        if os.access(folder / name, os.X_OK) and (folder / name).is_file():
            return [str(folder / name)]
    return [sys.executable, "-m", f"{PACKAGE}.ros.{name}_node"]
