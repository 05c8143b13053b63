# SPDX-License-Identifier: Apache-2.0
"""Bytes of an mcap file that have changed are noticed and named; a chunk costs itself alone, the index nothing."""

from pathlib import Path

import pytest
from mcap.reader import make_reader
from mcap.records import ChunkIndex
from mcap.writer import CompressionType, Writer

from uav_vslam.datasets.bag_recorder import RawRecorder
from uav_vslam.datasets.cdr import RawMessage
from uav_vslam.datasets.rosbag import iter_raw, topics_of
from uav_vslam.datasets.unindexed_mcap import END
from uav_vslam.errors import BagError

MESSAGE = ("/uav1/data", "std_msgs/msg/UInt8MultiArray")


def messages(count: int) -> list[RawMessage]:
    return [RawMessage(*MESSAGE, 10 * k, bytes([0, 1, 0, 0, k % 256]) * 20_000) for k in range(count)]


def record(path: Path, by: str) -> Path:
    """Record 60 messages of 100 kB with our recorder, or as `ros2 bag record` does; return the file."""
    if by.startswith("ours"):
        with RawRecorder(path, zstd=by == "ours, zstd") as recorder:
            for raw in messages(60):
                recorder.write(raw.topic, raw.msgtype, raw.data, raw.stamp_ns)
        return path / f"{path.name}.mcap"
    path.mkdir()
    with (path / "ros.mcap").open("wb") as stream:
        writer = Writer(stream, chunk_size=1 << 20, compression=CompressionType[by])
        writer.start(profile="ros2")
        channel = writer.register_channel(MESSAGE[0], "cdr", writer.register_schema(MESSAGE[1], "ros2msg", b"\0"))
        for raw in messages(60):
            writer.add_message(channel, raw.stamp_ns, raw.data, raw.stamp_ns)
        writer.finish()
    return path / "ros.mcap"


def flip(file: Path, number: int) -> ChunkIndex:
    """Change a bit in the middle of a chunk and return where it is."""
    with file.open("r+b") as stream:
        summary = make_reader(stream).get_summary()
        assert summary is not None
        chunk = summary.chunk_indexes[number]
        stream.seek(chunk.chunk_start_offset + chunk.chunk_length // 2)
        (byte,) = stream.read(1)
        stream.seek(-1, 1)
        stream.write(bytes([byte ^ 0x10]))
    return chunk


@pytest.mark.parametrize("by", ["ours", "ours, zstd", "NONE", "LZ4", "ZSTD"])
def test_a_damaged_chunk_costs_its_messages_and_is_named(by: str, tmp_path: Path) -> None:
    file = record(tmp_path / "bag", by)
    assert [raw.data for raw in iter_raw([file])] == [raw.data for raw in messages(60)]
    chunk = flip(file, 2)
    for bag in (file, file.parent):  # with its metadata, if there are any
        read: list[RawMessage] = []
        with pytest.raises(BagError, match="is damaged: 1 of its chunks can't be read") as told:
            read.extend(iter_raw([bag]))
        first, last = chunk.message_start_time, chunk.message_end_time
        assert f"the first from stamp {first} to {last} ns (" in str(told.value)
        lost = [raw.data for raw in messages(60) if first <= raw.stamp_ns <= last]
        assert 0 < len(lost) < 15
        assert [raw.data for raw in read] == [raw.data for raw in messages(60) if raw.data not in lost]


def test_a_damaged_chunk_of_a_truncated_file_ends_it(tmp_path: Path) -> None:
    file = record(tmp_path / "bag", "ours")
    chunk = flip(file, 2)
    file.write_bytes(file.read_bytes()[:-1])
    read: list[RawMessage] = []
    with pytest.raises(BagError, match="is damaged: read up to the damage"):
        read.extend(iter_raw([file]))
    assert [raw.data for raw in read] == [raw.data for raw in messages(60) if raw.stamp_ns < chunk.message_start_time]


@pytest.mark.parametrize("by", ["ours", "ZSTD"])
@pytest.mark.parametrize("share", [0.0, 0.3, 0.7, 0.98])
def test_a_damaged_index_costs_nothing_and_is_named(share: float, by: str, tmp_path: Path) -> None:
    file = record(tmp_path / "bag", by)
    data, expected = bytearray(file.read_bytes()), topics_of([file])
    start, _, _, _ = END.unpack_from(data, len(data) - END.size)
    data[start + int(share * (len(data) - start))] ^= 0x10
    file.write_bytes(data)
    for bag in (file, file.parent):
        read: list[RawMessage] = []
        with pytest.raises(BagError, match=r"is damaged: .*\(all messages are there, but the index after them"):
            read.extend(iter_raw([bag]))
        assert [(raw.stamp_ns, raw.data) for raw in read] == [(raw.stamp_ns, raw.data) for raw in messages(60)]
        assert topics_of([bag]) == expected
