# SPDX-License-Identifier: Apache-2.0
"""An mcap file that is not of ROS 2 is called what it is, and not damaged."""

from pathlib import Path

import pytest
from mcap.writer import Writer

from uav_vslam.datasets.foreign_mcap import what_is_foreign
from uav_vslam.datasets.rosbag import iter_raw, topics_of
from uav_vslam.errors import BagError

IMU = "sensor_msgs/msg/Imu"


def write(path: Path, profile: str, *channels: tuple[str, str, str]) -> Path:
    """Write a file with a message on each channel: topic, encoding of messages, encoding of the schema."""
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start(profile=profile)
        for topic, encoding, schema in channels:
            number = writer.register_schema(name=IMU, encoding=schema, data=b"int8 x\n")
            channel = writer.register_channel(topic=topic, message_encoding=encoding, schema_id=number)
            writer.add_message(channel_id=channel, log_time=1, publish_time=1, data=b"\0\1\0\0\0")
        writer.finish()
    return path


@pytest.mark.parametrize(
    ("profile", "encoding", "schema", "said"),
    [
        ("ros1", "ros1", "ros1msg", "it has ROS 1's profile, and messages of /imu are ros1"),
        ("", "cdr", "ros2msg", "it has no profile;"),
        ("x", "json", "jsonschema", "it has the profile 'x', and messages of /imu are json"),
        ("ros2", "protobuf", "protobuf", "messages of /imu are protobuf"),
    ],
)
@pytest.mark.parametrize("inside", [False, True])
def test_a_file_of_another_kind_is_called_so(
    inside: bool, profile: str, encoding: str, schema: str, said: str, tmp_path: Path
) -> None:
    file = write(tmp_path / "other.mcap", profile, ("/imu", encoding, schema))
    if inside:
        (tmp_path / "metadata.yaml").write_text("rosbag2_bagfile_information: {}\n")
    for read in (topics_of, lambda paths: list(iter_raw(paths))):
        with pytest.raises(BagError) as refused:
            read([tmp_path if inside else file])
        assert f"{file} is not of ROS 2: {said}" in str(refused.value)
        assert "damaged" not in str(refused.value)


def test_of_many_foreign_topics_a_few_are_named(tmp_path: Path) -> None:
    channels = [(f"/{name}", "protobuf", "protobuf") for name in "edcba"]
    file = write(tmp_path / "other.mcap", "ros2", ("/imu", "cdr", "ros2msg"), *channels)
    assert what_is_foreign(file) == "messages of /a, /b, /c and 2 more are protobuf"


def test_a_file_of_ros_2_and_what_can_not_be_read_have_nothing_foreign(tmp_path: Path) -> None:
    assert what_is_foreign(write(tmp_path / "sound.mcap", "ros2", ("/imu", "cdr", "ros2idl"))) == ""
    (tmp_path / "fake.mcap").write_bytes(b"hello")
    assert what_is_foreign(tmp_path / "fake.mcap") == ""
    assert what_is_foreign(tmp_path / "absent.mcap") == ""
