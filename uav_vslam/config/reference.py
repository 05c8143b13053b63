# SPDX-License-Identifier: Apache-2.0
"""The reference page of all parameters, from the settings themselves.

python -m uav_vslam.config.reference > docs/reference/parameters.md
"""

import json
from collections.abc import Mapping

from uav_vslam.config.nodes import NODES
from uav_vslam.config.settings import Setting, all_settings, plain, sections
from uav_vslam.config.vehicle import VehicleConfig

HEAD = """# Parameters

Made by `python -m uav_vslam.config.reference > docs/reference/parameters.md`; a test keeps it equal to the code.

A name is the same in a parameter file (`config/*.yaml`), with `--set NAME=VALUE` and as a ROS parameter
(`-p NAME:=VALUE`). Those marked *live* can change while the node runs (`ros2 param set`); all others are read-only.
A node declares those that it uses; it ignores those of other nodes, and refuses names that no node has.
"""


def page() -> str:
    """Return the page (Markdown)."""
    parts = [HEAD, "## Of a vehicle\n"]
    for name, section in sections(VehicleConfig).items():
        settings = all_settings(section, f"{name}.")
        parts.append(f"### {name}\n\n{section.__doc__} {_users(settings)}\n\n{_table(settings)}")
    parts.append("## Of single nodes\n")
    for name, node in NODES.items():
        parts.append(f"### {name}\n\n{_table(all_settings(node.own))}")
    return "\n".join(parts)


def _users(settings: Mapping[str, Setting]) -> str:
    """Say which nodes declare a section's settings."""
    users = {}
    for node, parameters in NODES.items():
        used = [name for name in settings if name in parameters.used_names]
        if used:
            users[node] = f"`{node}`" if len(used) == len(settings) else f"`{node}` ({', '.join(used)})"
    return f"Declared by {', '.join(users.values())}."


def _table(settings: Mapping[str, Setting]) -> str:
    head = "| parameter | default | unit | allowed | live | meaning |\n|---|---|---|---|---|---|\n"
    return head + "".join(f"{_row(name, described)}\n" for name, described in settings.items())


def _row(name: str, described: Setting) -> str:
    default = plain(described.default)
    cells = (
        f"`{name}`",
        f"`{json.dumps(default)}`" if default not in ("", []) else "",
        described.unit,
        described.range,
        "live" if described.live else "",
        described.text,
    )
    return f"| {' | '.join(cells)} |".replace("  ", " ")


if __name__ == "__main__":
    print(page(), end="")
