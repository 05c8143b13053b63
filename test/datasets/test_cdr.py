# SPDX-License-Identifier: Apache-2.0
"""Every message of ours has a type, and wrong bytes are refused."""

import dataclasses
from pathlib import Path

import pytest
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from uav_vslam.datasets.cdr import RawMessage, decode, typestore
from uav_vslam.datasets.rosbag import iter_raw
from uav_vslam.errors import BagError

OWN_MESSAGES = sorted((Path(__file__).resolve().parents[2] / "uav_vslam_msgs" / "msg").glob("*.msg"))


def test_every_message_of_ours_has_a_known_type() -> None:
    assert OWN_MESSAGES
    for path in OWN_MESSAGES:
        assert f"uav_vslam_msgs/msg/{path.stem}" in typestore().types


def test_bytes_that_do_not_fit_their_type_are_refused(tiny_bag: Path) -> None:
    raw = next(iter_raw([tiny_bag], ["/uav1/imu/data_raw"]))
    with pytest.raises(BagError, match="not a valid sensor_msgs/msg/Imu"):
        decode(dataclasses.replace(raw, data=raw.data[:20]))


QUALITY, FRAMES = "uav_vslam_msgs/msg/FrameQuality", 3
FIRST_VERSION = "std_msgs/Header header\nuint32 features\nfloat64 nis\n"


def first_version(path: Path, storage: StoragePlugin) -> Path:
    """Write a bag whose `FrameQuality` has two fields."""
    store = get_typestore(Stores.ROS2_JAZZY)
    store.register(get_types_from_msg(FIRST_VERSION, QUALITY))
    stamp = store.types["builtin_interfaces/msg/Time"](sec=5, nanosec=6)
    header = store.types["std_msgs/msg/Header"](stamp=stamp, frame_id="uav1/map")
    with Writer(path, version=9, storage_plugin=storage) as writer:
        connection = writer.add_connection("/uav1/slam/quality", QUALITY, typestore=store)
        for k in range(FRAMES):
            built = store.types[QUALITY](header=header, features=7 + k, nis=1.5)
            writer.write(connection, 10 + k, store.serialize_cdr(built, QUALITY))
    return path


def assert_first_version(found: list[RawMessage]) -> None:
    built = [decode(raw) for raw in found]
    assert [(one.header.stamp.sec, one.features, one.nis) for one in built] == [(5, 7 + k, 1.5) for k in range(FRAMES)]
    assert not hasattr(built[0], "landmarks")


@pytest.mark.parametrize("storage", [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
def test_a_message_of_another_version_is_decoded_as_its_bag_defines_it(tmp_path: Path, storage: StoragePlugin) -> None:
    found = list(iter_raw([first_version(tmp_path / "bag", storage)]))
    assert_first_version(found)
    with pytest.raises(BagError, match="not a valid"):  # with the present definition it can't be
        decode(dataclasses.replace(found[0], definition=""))


def test_so_it_is_in_a_truncated_file(tmp_path: Path) -> None:
    (file,) = first_version(tmp_path / "bag", StoragePlugin.MCAP).glob("*.mcap")
    truncated = tmp_path / "truncated.mcap"
    truncated.write_bytes(file.read_bytes()[:-9])
    found: list[RawMessage] = []
    with pytest.raises(BagError, match="damaged"):
        found.extend(iter_raw([truncated]))
    assert_first_version(found)


def test_a_definition_that_can_not_be_read_is_as_good_as_none(tiny_bag: Path) -> None:
    start = next(iter_raw([tiny_bag], ["/uav1/initial_state"]))
    expected = decode(start)
    assert decode(dataclasses.replace(start, definition="???")).header == expected.header
