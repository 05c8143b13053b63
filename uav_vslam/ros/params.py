# SPDX-License-Identifier: Apache-2.0
"""ROS parameters from configuration dataclasses: names, types and defaults have their one home in `config`."""

import typing
from pathlib import Path
from typing import Any

from rclpy.node import Node

from uav_vslam.config import build, flatten

Config = typing.TypeVar("Config")


def declare(node: Node, cls: type[Config]) -> Config:
    """Declare a parameter for every field of a (nested) configuration class and return what was set.

    Raises:
        ConfigError: a value is out of range; the text names node, key and what is allowed.
    """
    tree: dict[str, Any] = {}
    for dotted, default in flatten(cls()).items():
        value = node.declare_parameter(dotted, _parameter(default)).value
        *sections, key = dotted.split(".")
        branch = tree
        for section in sections:
            branch = branch.setdefault(section, {})
        branch[key] = tuple(Path(v) for v in value if v) if isinstance(default, tuple) else value
    return typing.cast(Config, build(cls, tree, where=f"parameters of {node.get_fully_qualified_name()}"))


def _parameter(default: Any) -> Any:
    return [str(item) for item in default] or [""] if isinstance(default, tuple) else default
