# SPDX-License-Identifier: Apache-2.0
"""Writes a ROS 1 bag of a ROS 2 bag."""

from pathlib import Path
from typing import Any

from rosbags.rosbag1 import Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from uav_vslam.datasets.cdr import MESSAGE_PACKAGE, decode, typestore
from uav_vslam.datasets.rosbag import iter_raw

RENAMED = ("D", "K", "R", "P")  # fields of CameraInfo that ROS 2 has in lower case


def write_ros1(source: Path, out: Path) -> Path:
    """Copy a ROS 2 bag into a ROS 1 file; our own messages are of the same package there."""
    store = _store()
    connections: dict[str, Any] = {}
    with Writer(out) as writer:
        for raw in iter_raw([source]):
            if raw.topic not in connections:
                connections[raw.topic] = writer.add_connection(raw.topic, raw.msgtype, typestore=store)
            data = store.serialize_ros1(_as_ros1(decode(raw), store), raw.msgtype)
            writer.write(connections[raw.topic], raw.stamp_ns, data)
    return out


def _store() -> Typestore:
    """Return the types of ROS 1 with those that a flight needs beside them."""
    store = get_typestore(Stores.ROS1_NOETIC)
    store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", "tf2_msgs/msg/TFMessage"))
    ours = f"{MESSAGE_PACKAGE}/msg/NavigationState"
    text, _ = typestore().generate_msgdef(ours)
    store.register(get_types_from_msg(text.partition("=" * 80)[0], ours))
    return store


def _as_ros1(value: Any, store: Typestore) -> Any:
    """Return a message of ROS 2 as one of ROS 1: headers count, CameraInfo has capitals."""
    if isinstance(value, list):
        return [_as_ros1(item, store) for item in value]
    if not hasattr(value, "__msgtype__"):
        return value
    names = [name for name, _ in store.fielddefs[value.__msgtype__][1]]
    fields = {name: 7 if name == "seq" else _as_ros1(getattr(value, name, None), store) for name in names}
    fields |= {name: _as_ros1(getattr(value, name.lower()), store) for name in names if name in RENAMED}
    return store.types[value.__msgtype__](**fields)
