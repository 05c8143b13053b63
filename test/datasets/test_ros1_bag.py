# SPDX-License-Identifier: Apache-2.0
"""A flight in a ROS 1 bag, as rosbags writes it, reads like the ROS 2 bag that it was made of."""

from pathlib import Path

import numpy as np
import pytest
from rosbags.rosbag1 import Writer
from rosbags.typesys import Stores, get_typestore

from uav_vslam.config import InputConfig
from uav_vslam.datasets.bag import open_flight, vehicles
from uav_vslam.datasets.cdr import decode
from uav_vslam.datasets.rosbag import iter_raw, topics_of
from uav_vslam.errors import BagError
from uav_vslam.studies.recordings.ros1 import write_ros1
from uav_vslam.types import ImuSample


@pytest.fixture(scope="module")
def ros1_bag(tiny_bag: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_ros1(tiny_bag, tmp_path_factory.mktemp("ros1") / "flight.bag")


def test_every_message_is_the_one_of_the_ros_2_bag(tiny_bag: Path, ros1_bag: Path) -> None:
    theirs = list(iter_raw([tiny_bag]))
    ours = list(iter_raw([ros1_bag]))
    for topic in {raw.topic for raw in theirs}:  # messages of one recording stamp may come in another order
        assert [raw for raw in ours if raw.topic == topic] == [raw for raw in theirs if raw.topic == topic]
    assert len(ours) == len(theirs)


def test_the_flight_is_the_same(tiny_bag: Path, ros1_bag: Path) -> None:
    assert vehicles([ros1_bag]) == ["uav1", "uav2"]
    assert topics_of([ros1_bag])["/tf_static"].latched
    flight, expected = (open_flight(bag, "uav1", InputConfig()) for bag in (ros1_bag, tiny_bag))
    assert flight.frame_count == 6
    assert flight.initial_state is not None
    np.testing.assert_array_equal(flight.initial_state.covariance, expected.initial_state.covariance)
    np.testing.assert_array_equal(flight.rig.T_body_right.matrix, expected.rig.T_body_right.matrix)
    for ours, theirs in zip(flight.iter_events(), expected.iter_events(), strict=True):
        assert ours.stamp_ns == theirs.stamp_ns
        if isinstance(theirs, ImuSample):
            np.testing.assert_array_equal(ours.accel, theirs.accel)
        else:
            np.testing.assert_array_equal(ours.right, theirs.right)


def test_a_truncated_bag_is_named_with_what_restores_it(ros1_bag: Path, tmp_path: Path) -> None:
    broken = tmp_path / "broken.bag"
    broken.write_bytes(ros1_bag.read_bytes()[:-5000])
    with pytest.raises(BagError, match=r"broken\.bag is damaged.*restore its index by `rosbag reindex`"):
        topics_of([broken])


def test_a_message_that_can_not_be_read_costs_itself(tmp_path: Path) -> None:
    types = get_typestore(Stores.ROS1_NOETIC)
    reading = types.serialize_ros1(types.types["std_msgs/msg/Float64"](1.5), "std_msgs/msg/Float64")
    with Writer(tmp_path / "faulty.bag") as writer:
        connection = writer.add_connection("/imu", "std_msgs/msg/Float64", typestore=types)
        for stamp_ns, data in enumerate((reading, b"\1\2\3", reading)):
            writer.write(connection, stamp_ns, data)
    first, faulty, last = iter_raw([tmp_path / "faulty.bag"])
    assert [decode(raw).data for raw in (first, last)] == [1.5, 1.5]
    with pytest.raises(BagError, match="/imu at 1 ns: not a valid std_msgs/msg/Float64"):
        decode(faulty)


def test_names_without_a_slash_are_of_no_namespace(tmp_path: Path) -> None:
    """As `bag.write('imu', reading)` leaves them, which ROS 1 itself never does."""
    types = get_typestore(Stores.ROS1_NOETIC)
    reading = types.types["std_msgs/msg/Float64"](1.5)
    with Writer(tmp_path / "relative.bag") as writer:
        connection = writer.add_connection("imu", "std_msgs/msg/Float64", typestore=types)
        writer.write(connection, 7, types.serialize_ros1(reading, "std_msgs/msg/Float64"))
    assert topics_of([tmp_path / "relative.bag"])["/imu"].count == 1
    assert [raw.stamp_ns for raw in iter_raw([tmp_path / "relative.bag"], ["/imu"])] == [7]
