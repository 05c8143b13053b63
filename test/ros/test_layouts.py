# SPDX-License-Identifier: Apache-2.0
"""The layouts for RViz and Foxglove name what the nodes publish: topics, types, frames and fields, and can connect."""

import json
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest
import yaml

rclpy = pytest.importorskip("rclpy", reason="needs ROS")
from rclpy.qos import (  # noqa: E402
    DurabilityPolicy,
    QoSCompatibility,
    QoSProfile,
    ReliabilityPolicy,
    qos_check_compatible,
    qos_profile_sensor_data,
)

from uav_vslam.ros.fusion_node import FusionNode  # noqa: E402
from uav_vslam.ros.ins_propagator_node import InsPropagatorNode  # noqa: E402
from uav_vslam.ros.mapper_node import MapperNode  # noqa: E402
from uav_vslam.ros.slam_backend_node import SlamBackendNode  # noqa: E402
from uav_vslam.ros.stereo_frontend_node import StereoFrontendNode  # noqa: E402

pytestmark = pytest.mark.ros

ROOT = Path(__file__).parents[2]
RVIZ = ROOT / "config" / "rviz" / "uav_vslam.rviz"
FOXGLOVE = ROOT / "config" / "foxglove" / "uav_vslam.json"
VEHICLES = ("uav1", "uav2")
NODES = (StereoFrontendNode, InsPropagatorNode, SlamBackendNode, FusionNode, MapperNode)
RVIZ_TYPES = {
    "Odometry": {"nav_msgs/msg/Odometry"},
    "Path": {"nav_msgs/msg/Path"},
    "PointCloud2": {"sensor_msgs/msg/PointCloud2"},
    "PoseWithCovariance": {"geometry_msgs/msg/PoseWithCovarianceStamped"},
    "Image": {"sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"},
}
FOXGLOVE_TYPES = {  # of the topics that a panel's settings name
    "3D": {"nav_msgs/msg/Path", "sensor_msgs/msg/PointCloud2", "geometry_msgs/msg/PoseWithCovarianceStamped"},
    "imageTopic": {"sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"},
    "calibrationTopic": {"sensor_msgs/msg/CameraInfo"},
    "topicToRender": {"diagnostic_msgs/msg/DiagnosticArray"},
}
MODIFIERS = {"@sqrt", "@rad2deg"}
PATH = re.compile(r"(/[\w/]+)((?:\.@?\w+|\[\d+\])*)")


@dataclass
class Offered:
    """What two vehicles' nodes publish, the sensors that they subscribe to, and their frames."""

    types: dict[str, str] = field(default_factory=dict)
    qos: dict[str, QoSProfile] = field(default_factory=dict)
    frames: set[str] = field(default_factory=set)

    def take(self, node: Any) -> None:
        """Add a node's topics; a driver may offer its own, a sensor's, with the least QoS."""
        for one in node.subscriptions:
            self.types.setdefault(one.topic_name, type_name(one.msg_type))
            self.qos.setdefault(one.topic_name, qos_profile_sensor_data)
        for one in node.publishers:
            self.types[one.topic_name] = type_name(one.msg_type)
            self.qos[one.topic_name] = one.qos_profile
        self.frames |= {node.map_frame, node.odom_frame, node.base_frame, node.world_frame}


def type_name(kind: Any) -> str:
    return f"{kind.__module__.split('.')[0]}/msg/{kind.__name__}"


@pytest.fixture(scope="module")
def offered() -> Offered:
    """Start the nodes of two vehicles, one after the other."""
    from uav_vslam.ros.domain import claimed_domain

    found = Offered()
    with claimed_domain() as domain_id:
        for vehicle in VEHICLES:
            rclpy.init(args=["--ros-args", "-r", f"__ns:=/{vehicle}"], domain_id=domain_id)
            nodes = [make() for make in NODES]
            for node in nodes:
                found.take(node)
                node.destroy_node()
            rclpy.shutdown()
    return found


def rviz_displays(entry: dict[str, Any]) -> Iterator[dict[str, Any]]:
    for one in entry.get("Displays", []):
        yield one
        yield from rviz_displays(one)


def rviz() -> dict[str, Any]:
    return dict(yaml.safe_load(RVIZ.read_text())["Visualization Manager"])


SHOWN = [one for one in rviz_displays(rviz()) if "Topic" in one]


def foxglove() -> dict[str, Any]:
    return dict(json.loads(FOXGLOVE.read_text()))


@pytest.mark.parametrize("display", SHOWN, ids=lambda one: one["Topic"]["Value"])
def test_an_rviz_display_has_a_topic_of_its_type(display: dict[str, Any], offered: Offered) -> None:
    kind = display["Class"].removeprefix("rviz_default_plugins/")
    assert offered.types[display["Topic"]["Value"]] in RVIZ_TYPES[kind]


@pytest.mark.parametrize("display", SHOWN, ids=lambda one: one["Topic"]["Value"])
def test_an_rviz_display_can_connect(display: dict[str, Any], offered: Offered) -> None:
    topic = display["Topic"]
    asked = QoSProfile(
        depth=topic["Depth"],
        reliability=ReliabilityPolicy[topic["Reliability Policy"].upper().replace(" ", "_")],
        durability=DurabilityPolicy[topic["Durability Policy"].upper().replace(" ", "_")],
    )
    found, reason = qos_check_compatible(offered.qos[topic["Value"]], asked)
    assert found != QoSCompatibility.ERROR, reason


def test_rviz_shows_both_vehicles_alike() -> None:
    first, second = (
        [(one["Name"], one["Topic"]["Value"].removeprefix(f"/{vehicle}/"), one["Enabled"]) for one in group["Displays"]]
        for vehicle in VEHICLES
        for group in rviz()["Displays"]
        if group["Name"] == vehicle
    )
    assert first == second
    assert {name for _, name, _ in first} >= {"fused/odometry", "fused/path", "fused/landmarks", "odometry"}


def test_rviz_names_frames_that_are_published(offered: Offered) -> None:
    (tf,) = (one for one in rviz_displays(rviz()) if one["Class"] == "rviz_default_plugins/TF")
    named = set(tf["Frames"]) - {"All Enabled"}
    assert named == offered.frames
    assert tree_frames(tf["Tree"]) == offered.frames
    assert rviz()["Global Options"]["Fixed Frame"] in offered.frames


def tree_frames(tree: dict[str, Any]) -> set[str]:
    return set(tree) | {frame for below in tree.values() for frame in tree_frames(below)}


def panels_of(layout: Any) -> list[str]:
    """Return the panels in a tree of splits, those of its tabs included."""
    if isinstance(layout, str):
        tabs = foxglove()["configById"].get(layout, {}).get("tabs", [])
        return [layout, *(name for tab in tabs for name in panels_of(tab["layout"]))]
    return panels_of(layout["first"]) + panels_of(layout["second"])


def test_each_foxglove_panel_has_one_place() -> None:
    assert sorted(panels_of(foxglove()["layout"])) == sorted(foxglove()["configById"])


def named_topics(panel: str, config: dict[str, Any]) -> Iterator[tuple[str, set[str]]]:
    """Yield the topics that a panel's settings name, with the types that it can show."""
    if panel.startswith("3D!"):
        yield from ((topic, FOXGLOVE_TYPES["3D"]) for topic in config["topics"])
    for key, value in {**config, **config.get("imageMode", {})}.items():
        if key in FOXGLOVE_TYPES:
            yield value, FOXGLOVE_TYPES[key]


NAMED = [found for panel, config in foxglove()["configById"].items() for found in named_topics(panel, config)]
PATHS = [
    path
    for config in foxglove()["configById"].values()
    for path in (*(one["value"] for one in config.get("paths", [])), *filter(None, [config.get("topicPath")]))
]


@pytest.mark.parametrize(("topic", "shows"), NAMED, ids=[topic for topic, _ in NAMED])
def test_a_foxglove_panel_has_a_topic_of_its_type(topic: str, shows: set[str], offered: Offered) -> None:
    assert offered.types[topic] in shows


def test_foxglove_names_frames_that_are_published(offered: Offered) -> None:
    scene = foxglove()["configById"]["3D!fleet"]
    assert {name.removeprefix("frame:") for name in scene["transforms"]} == offered.frames
    assert {scene["followTf"], *(layer["frameId"] for layer in scene["layers"].values())} <= offered.frames


def message(name: str) -> Any:
    package, _, kind = name.rpartition("/")
    return getattr(import_module(f"{package.partition('/')[0]}.msg"), kind)()


def resolve(path: str, types: dict[str, str]) -> Any:
    """Return the value of a message path in a default message; a list has a default entry.

    Raises:
        KeyError, AttributeError, IndexError: there is no such topic, field or entry.
    """
    match = PATH.fullmatch(path)
    assert match, path
    value = message(types[match[1]])
    entries = ""
    for step in re.findall(r"\.(@?\w+)|\[(\d+)\]", match[2]):
        if step[0].startswith("@"):
            assert step[0] in MODIFIERS
            value = float(value)
        elif step[0]:
            entries = value.get_fields_and_field_types()[step[0]]
            value = getattr(value, step[0])
        elif entries.startswith("sequence<"):
            value = message(entries.removeprefix("sequence<").removesuffix(">"))
        else:
            value = value[int(step[1])]
    return value


@pytest.mark.parametrize("path", PATHS)
def test_a_foxglove_path_leads_to_a_field(path: str, offered: Offered) -> None:
    value = resolve(path, offered.types)
    if "." in path:
        assert isinstance(float(value), float)


@pytest.mark.parametrize(
    "path",
    [
        "/uav1/odometri.pose.covariance[0]",
        "/uav1/odometry.pose.covariance[36]",
        "/uav1/odometry.pose.sigma",
        "/uav1/fusion/status.peers[0].bytes",
    ],
)
def test_wrong_paths_are_noticed(path: str, offered: Offered) -> None:
    with pytest.raises((KeyError, AttributeError, IndexError)):
        resolve(path, offered.types)
