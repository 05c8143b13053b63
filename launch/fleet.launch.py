# SPDX-License-Identifier: Apache-2.0
"""Start a fleet under ROS 2 launch: `ros2 launch uav_vslam fleet.launch.py fleet:=FILE`.

The same nodes with the same parameters as `uav-vslam launch FILE`; both use uav_vslam.ros.fleet_commands.
"""

from pathlib import Path

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction, Shutdown
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare

from uav_vslam.config import load_fleet, load_link
from uav_vslam.ros.fleet_commands import node_specs


def start_fleet(context):
    """Return one action per node; when the replay ends, the launch shuts down."""
    file = Path(LaunchConfiguration("fleet").perform(context)).resolve()
    link = LaunchConfiguration("link").perform(context)
    return [
        Node(
            package="uav_vslam",
            executable=spec.executable,
            name=spec.name,
            namespace=spec.namespace,
            parameters=[spec.parameters],
            remappings=list(spec.remappings.items()),
            output="screen",
            on_exit=Shutdown(reason="the replay has ended") if spec.executable == "replay" else None,
        )
        for spec in node_specs(load_fleet(file), link=load_link(link) if link else None)
    ]


def generate_launch_description():
    """Entry point of `ros2 launch`."""
    demo = PathJoinSubstitution([FindPackageShare("uav_vslam"), "config", "fleet_demo.yaml"])
    return LaunchDescription(
        [
            DeclareLaunchArgument("fleet", default_value=demo, description="fleet file: vehicles, replay, mode"),
            DeclareLaunchArgument("link", default_value="", description="emulated radio link: a name in config/links"),
            OpaqueFunction(function=start_fleet),
        ]
    )
