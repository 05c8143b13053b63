# SPDX-License-Identifier: Apache-2.0
"""An mcap file that is not of ROS 2 is called what it is, and not damaged; a mixed one is read in part."""

from pathlib import Path

import pytest
from mcap.reader import make_reader
from mcap.writer import Writer

from uav_vslam.datasets.bag import open_flight
from uav_vslam.datasets.foreign_mcap import what_is_foreign
from uav_vslam.datasets.rosbag import iter_raw, iter_readable, topics_of
from uav_vslam.errors import BagError

IMU, LEFT = "sensor_msgs/msg/Imu", "/uav1/left/image_raw"


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
        ("", "json", "", "it has no profile, and messages of /imu are json"),
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


@pytest.mark.parametrize("profile", ["ros2", "", "x"])  # `mcap merge` leaves none where its inputs differ
@pytest.mark.parametrize("damage", ["none", "truncated"])
def test_the_topics_of_ros_2_are_read_and_others_named(
    damage: str, profile: str, tiny_bag: Path, tmp_path: Path
) -> None:
    file, expected = tmp_path / "mixed.mcap", list(iter_raw([tiny_bag]))
    with (tiny_bag / "tiny.mcap").open("rb") as stream:
        summary = make_reader(stream).get_summary()
    qos = {channel.topic: channel.metadata for channel in summary.channels.values()}
    with file.open("wb") as stream:
        writer = Writer(stream, chunk_size=1 << 16)
        writer.start(profile=profile)
        others = [
            writer.register_channel("log", "protobuf", writer.register_schema("foxglove.Log", "protobuf", b"\0")),
            writer.register_channel("/status", "json", schema_id=0),
        ]
        channels: dict[str, int] = {}
        for raw in expected:
            if raw.topic not in channels:
                schema = writer.register_schema(raw.msgtype, "ros2msg", raw.definition.encode())
                channels[raw.topic] = writer.register_channel(raw.topic, "cdr", schema, qos[raw.topic])
            for channel, data in ((channels[raw.topic], raw.data), *((one, b"{}") for one in others)):
                writer.add_message(channel, raw.stamp_ns, data, raw.stamp_ns)
        writer.finish()
    if damage == "truncated":
        file.write_bytes(file.read_bytes()[:-1])
        assert list(iter_readable([file], [raw.topic for raw in expected])) == expected
        return
    assert list(iter_raw([file])) == expected
    assert topics_of([file]) == topics_of([tiny_bag])
    assert topics_of([file]).foreign == {"/log": "protobuf", "/status": "json"}
    (warning,) = [text for text in open_flight(file, "uav1").warnings if "protobuf" in text]
    assert warning == "messages of /log are protobuf, and messages of /status are json instead of CDR, and are not read"


def test_a_needed_topic_in_another_encoding_is_named(tmp_path: Path) -> None:
    file = write(tmp_path / "mixed.mcap", "ros2", ("/imu", "cdr", "ros2msg"), (LEFT, "protobuf", "protobuf"))
    with pytest.raises(BagError, match=f"messages of {LEFT} are protobuf, which can't be read"):
        open_flight(file, "uav1")


def test_of_many_foreign_topics_a_few_are_named(tmp_path: Path) -> None:
    channels = [(f"/{name}", "protobuf", "protobuf") for name in "edcba"]
    file = write(tmp_path / "other.mcap", "ros2", ("/imu", "cdr", "ros2msg"), *channels)
    assert what_is_foreign(file) == "messages of /a, /b, /c and 2 more are protobuf"


def test_a_file_of_ros_2_and_what_can_not_be_read_have_nothing_foreign(tmp_path: Path) -> None:
    assert what_is_foreign(write(tmp_path / "sound.mcap", "ros2", ("/imu", "cdr", "ros2idl"))) == ""
    (tmp_path / "fake.mcap").write_bytes(b"hello")
    assert what_is_foreign(tmp_path / "fake.mcap") == ""
    assert what_is_foreign(tmp_path / "absent.mcap") == ""
