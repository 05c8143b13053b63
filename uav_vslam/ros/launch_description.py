# SPDX-License-Identifier: Apache-2.0
"""What launch/*.launch.py start under ROS 2 launch: the nodes of `uav-vslam launch`, with the same parameters.

`launch` and `launch_ros` come with a ROS installation; the wheels from PyPI have neither.
"""

from pathlib import Path
from typing import Any

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction, Shutdown
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare

from uav_vslam.config import load_fleet, load_link
from uav_vslam.ros.fleet_commands import NodeSpec, node_specs

ARGUMENTS = {
    "bag": "recording to replay instead of those of the fleet file",
    "rate": "multiple of real time; 0: paced by the graph (lock-step)",
    "mode": "how the vehicles communicate: wideband, narrowband or none",
    "link": "emulated radio link: a name in config/links",
    "record": "record the estimates into this new bag",
    "use_sim_time": "true: nodes take the time from /clock (default: with a replay)",
    "log_level": "of all nodes",
    "rviz": "true: start RViz with the layout for uav1 and uav2",
}


def description(*, one_vehicle: bool) -> LaunchDescription:
    """Return the launch description of a whole fleet, or of one vehicle with its own computer."""
    demo = PathJoinSubstitution([FindPackageShare("uav_vslam"), "config", "fleet_demo.yaml"])
    required = [DeclareLaunchArgument("vehicle", description="name in the fleet file")] if one_vehicle else []
    return LaunchDescription(
        [
            *required,
            DeclareLaunchArgument("fleet", default_value=demo, description="fleet file: vehicles, replay, mode, radio"),
            *(DeclareLaunchArgument(name, default_value="", description=text) for name, text in ARGUMENTS.items()),
            OpaqueFunction(function=lambda context: _nodes(context, ["vehicle"] if one_vehicle else [])),
        ]
    )


def _nodes(context: Any, names: list[str]) -> list[Node]:
    """Return one action per node; when the replay ends, the launch shuts down."""
    given = {name: LaunchConfiguration(name).perform(context) for name in ("fleet", *ARGUMENTS, *names)}
    fleet = load_fleet(Path(given["fleet"]).resolve()).changed(
        bags=[Path(given["bag"])] if given["bag"] else None,
        rate=float(given["rate"]) if given["rate"] else None,
        mode=given["mode"] or None,
    )
    specs = node_specs(
        fleet,
        link=load_link(given["link"]) if given["link"] else None,
        vehicles=[given[name] for name in names],
        use_sim_time=given["use_sim_time"].lower() == "true" if given["use_sim_time"] else None,
        record=given["record"],
    )
    nodes = [_action(spec, given["log_level"]) for spec in specs]
    if given["rviz"].lower() == "true":
        nodes.append(_rviz(any(spec.parameters.get("use_sim_time") for spec in specs)))
    return nodes


def _action(spec: NodeSpec, log_level: str) -> Node:
    return Node(
        package="uav_vslam",
        executable=spec.executable,
        name=spec.executable,
        namespace=spec.namespace,
        parameters=[spec.parameters],
        remappings=list(spec.remappings.items()),
        additional_env=spec.environment,
        ros_arguments=["--log-level", log_level] if log_level else [],
        output="screen",
        on_exit=Shutdown(reason="the replay has ended") if spec.executable == "replay" else None,
    )


def _rviz(use_sim_time: bool) -> Node:
    layout = PathJoinSubstitution([FindPackageShare("uav_vslam"), "rviz", "uav_vslam.rviz"])
    return Node(
        package="rviz2", executable="rviz2", arguments=["-d", layout], parameters=[{"use_sim_time": use_sim_time}]
    )
