# SPDX-License-Identifier: Apache-2.0
"""Overrides of a topic's QoS that do nothing. A parameter file may be for several nodes, so only one that none has."""

import difflib

from rclpy.node import Node

from uav_vslam.config.input import TopicsConfig, image_names
from uav_vslam.ros.params import QOS_CHOICES, QOS_OVERRIDES

INPUTS = "input.topics."
PUBLISHED = (
    *("ins/increment", "ins/dead_reckoning", "ins/odometry", "stereo_features", "odometry", "path", "landmarks"),
    *("joint_information", "slam/correction", "slam/smoothed", "slam/quality", "fused/odometry", "fused/path"),
    *("fused/landmarks", "fusion/status", "map/surface", "map/mesh", "/tf"),
)
RECEIVED = (
    *("ins/increment", "stereo_features", "odometry", "joint_information", "slam/correction", "slam/smoothed"),
    "/tf_static",
)


def warn_of_idle_qos(node: Node) -> None:
    """Warn of qos_overrides.* of a node that has opened its topics: those that neither it nor another one declares."""
    given = [name for name in node._parameter_overrides if name.startswith(QOS_OVERRIDES)]
    of_others = [name for name in given if not node.has_parameter(name)]
    if not of_others:
        return
    of_any = names_of_overrides(node)
    own = f"{QOS_OVERRIDES}{node.get_namespace().rstrip('/')}/"
    idle = [name for name in of_others if not {name, _moved(name, own)} & of_any]
    if idle:
        near = difflib.get_close_matches(idle[0], of_any, n=1)
        hint = f"; did you mean {near[0]}?" if near else ""
        node.get_logger().warning(f"without effect, for no topic of the nodes is set so: {', '.join(idle)}{hint}")


def _moved(name: str, own: str) -> str:
    """Return another vehicle's override as one of the own namespace."""
    _, _, rest = name.removeprefix(f"{QOS_OVERRIDES}/").partition("/")
    return own + rest


def names_of_overrides(node: Node) -> set[str]:
    """Return all overrides that some node of ours has in a node's namespace."""
    given = {k.removeprefix(INPUTS): p.value for k, p in node._parameter_overrides.items() if k.startswith(INPUTS)}
    topics = TopicsConfig(**given)
    inputs = (*image_names(topics.left), *image_names(topics.right), topics.left_info, topics.right_info, topics.imu)
    ends = {
        "publisher": (*PUBLISHED, topics.initial_state),
        "subscription": (*RECEIVED, *inputs, topics.initial_state),
    }
    return {
        f"{QOS_OVERRIDES}{node.resolve_topic_name(topic)}.{end}.{policy}"
        for end, names in ends.items()
        for topic in names
        for policy in (*QOS_CHOICES, "depth")
    }
