# SPDX-License-Identifier: Apache-2.0
"""A flight in a ROS 1 bag, as rosbags writes it, reads like the ROS 2 bag that it was made of."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.rosbag1 import Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from uav_vslam.config import InputConfig
from uav_vslam.datasets.bag import open_flight, vehicles
from uav_vslam.datasets.rosbag import decode, iter_raw, topics_of
from uav_vslam.errors import BagError
from uav_vslam.types import ImuSample

ROS1 = get_typestore(Stores.ROS1_NOETIC)
ROS1.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", "tf2_msgs/msg/TFMessage"))


def as_ros1(value: Any) -> Any:
    """Return a message of ROS 2 as one of ROS 1: headers count, CameraInfo has capitals."""
    if isinstance(value, list):
        return [as_ros1(item) for item in value]
    if not hasattr(value, "__msgtype__"):
        return value
    names = [name for name, _ in ROS1.fielddefs[value.__msgtype__][1]]
    fields = {name: 7 if name == "seq" else as_ros1(getattr(value, name, None)) for name in names}
    fields |= {name: as_ros1(getattr(value, name.lower())) for name in names if name in ("D", "K", "R", "P")}
    return ROS1.types[value.__msgtype__](**fields)


@pytest.fixture(scope="module")
def ros1_bag(tiny_bag: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("ros1") / "flight.bag"
    connections: dict[str, Any] = {}
    with Writer(path) as writer:
        for raw in iter_raw([tiny_bag]):
            if raw.msgtype.startswith("uav_vslam_msgs"):
                continue  # there is no such message in ROS 1
            if raw.topic not in connections:
                connections[raw.topic] = writer.add_connection(raw.topic, raw.msgtype, typestore=ROS1)
            data = ROS1.serialize_ros1(as_ros1(decode(raw)), raw.msgtype)
            writer.write(connections[raw.topic], raw.stamp_ns, data)
    return path


def test_every_message_is_the_one_of_the_ros_2_bag(tiny_bag: Path, ros1_bag: Path) -> None:
    theirs = [raw for raw in iter_raw([tiny_bag]) if not raw.msgtype.startswith("uav_vslam_msgs")]
    ours = list(iter_raw([ros1_bag]))
    for topic in {raw.topic for raw in theirs}:  # messages of one recording stamp may come in another order
        assert [raw for raw in ours if raw.topic == topic] == [raw for raw in theirs if raw.topic == topic]
    assert len(ours) == len(theirs)


def test_the_flight_is_the_same(tiny_bag: Path, ros1_bag: Path) -> None:
    assert vehicles([ros1_bag]) == ["uav1", "uav2"]
    assert topics_of([ros1_bag])["/tf_static"].latched
    flight, expected = (open_flight(bag, "uav1", InputConfig()) for bag in (ros1_bag, tiny_bag))
    assert flight.frame_count == 6
    assert flight.initial_state is None
    np.testing.assert_array_equal(flight.rig.T_body_right.matrix, expected.rig.T_body_right.matrix)
    for ours, theirs in zip(flight.iter_events(), expected.iter_events(), strict=True):
        assert ours.stamp_ns == theirs.stamp_ns
        if isinstance(theirs, ImuSample):
            np.testing.assert_array_equal(ours.accel, theirs.accel)
        else:
            np.testing.assert_array_equal(ours.right, theirs.right)


def test_a_truncated_bag_is_named(ros1_bag: Path, tmp_path: Path) -> None:
    broken = tmp_path / "broken.bag"
    broken.write_bytes(ros1_bag.read_bytes()[:-5000])
    with pytest.raises(BagError, match=r"broken\.bag is damaged"):
        topics_of([broken])
