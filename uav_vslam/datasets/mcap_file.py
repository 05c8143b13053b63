# SPDX-License-Identifier: Apache-2.0
"""An mcap file, of which rosbags reads what it can: damaged chunks and topics of other encodings cost themselves."""

import heapq
from collections.abc import Collection, Generator, Iterator
from typing import cast

from mcap.exceptions import McapError
from mcap.reader import make_reader
from mcap.records import Channel, Statistics
from mcap.records import Schema as McapSchema
from rosbags.interfaces import Connection, ConnectionExtRosbag2
from rosbags.rosbag2.errors import ReaderError
from rosbags.rosbag2.metadata import ReaderMetadata, parse_qos
from rosbags.rosbag2.storage_mcap import ChunkInfo, McapReader, Msg, Schema, get_msgdef, msgsrc

from uav_vslam.datasets.foreign_mcap import MESSAGES, foreign_topics, is_of_ros2


class McapFile(McapReader):
    """rosbags' reader of an mcap file.

    Attributes:
        foreign: encodings of the topics that are left out because ROS 2 can't read them.
        damage: of each chunk that could not be read so far: its stamps, and why.
    """

    def open(self) -> None:
        """Open the file; one that also holds other encodings, or has no profile, for the topics of ROS 2 in it."""
        self.foreign: dict[str, str] = {}
        self.damage: list[str] = []
        try:
            super().open()
        except (ReaderError, KeyError):  # KeyError: a schema that rosbags does not know
            if not self._open_in_part():
                raise
        formats = {one.topic: cast(ConnectionExtRosbag2, one.ext).serialization_format for one in self.connections}
        self.foreign |= {topic: encoding for topic, encoding in formats.items() if encoding != MESSAGES}
        self.connections = [one for one in self.connections if one.topic not in self.foreign]

    def messages(
        self, connections: Collection[Connection], start: int | None = None, stop: int | None = None
    ) -> Generator[tuple[Connection, int, bytes], None, None]:
        """Yield connection, recording stamp [ns] and data of all messages that can be read, in the order of stamps."""
        if not self.chunks or start is not None or stop is not None:
            yield from super().messages(connections, start, stop)
            return
        wanted = {connection.id: connection for connection in connections}
        sources = [
            self._readable(chunk, wanted)
            for chunk in self.chunks
            if not chunk.channel_count or not wanted.keys().isdisjoint(chunk.channel_count)
        ]
        for message in heapq.merge(*sources, key=lambda one: one[:2]):
            if message.connection is not None and message.data is not None:
                yield message.connection, message.timestamp, message.data

    def _readable(self, chunk: ChunkInfo, wanted: dict[int, Connection]) -> Iterator[Msg]:
        """Yield a chunk's messages, none if it is damaged."""
        assert self.bio
        first, last = chunk.message_start_time, chunk.message_end_time
        try:
            yield from msgsrc(chunk, wanted, first, last + 1, self.bio)
        except Exception as error:  # of any decompressor, or a wrong checksum
            self.damage.append(f"from stamp {first} to {last} ns ({error})")

    def _open_in_part(self) -> bool:
        """Open the file by its summary for the topics of ROS 2; return whether there are any."""
        bio = self.path.open("rb")
        try:
            summary = make_reader(bio).get_summary()
        except (McapError, ValueError, OSError):
            summary = None
        if summary is None or summary.statistics is None or not summary.chunk_indexes:
            bio.close()
            return False
        self.connections = [
            self._connection(channel, schema, summary.statistics)
            for channel in summary.channels.values()
            if (schema := summary.schemas.get(channel.schema_id)) is not None and is_of_ros2(channel, schema)
        ]
        if not self.connections:
            bio.close()
            return False
        self.bio, self.foreign = bio, foreign_topics(summary)
        self.chunks = [
            ChunkInfo(
                one.message_start_time,
                one.message_end_time,
                one.chunk_start_offset,
                one.chunk_length,
                one.message_index_offsets,
                one.message_index_length,
                one.compression,
                one.compressed_size,
                one.uncompressed_size,
                dict.fromkeys(one.message_index_offsets, 1),
            )
            for one in summary.chunk_indexes
        ]
        first, last = summary.statistics.message_start_time, summary.statistics.message_end_time
        count = sum(connection.msgcount for connection in self.connections)
        self.metadata = ReaderMetadata(last - first + 1, first, last + 1, count, None, None, None, None)
        return True

    def _connection(self, channel: Channel, schema: McapSchema, statistics: Statistics) -> Connection:
        definition = get_msgdef(Schema(schema.id, schema.name, schema.encoding, schema.data.decode(errors="replace")))
        qos = parse_qos(channel.metadata.get("offered_qos_profiles", []))
        ext = ConnectionExtRosbag2(channel.message_encoding, qos)
        count = statistics.channel_message_counts.get(channel.id, 0)
        return Connection(channel.id, channel.topic, schema.name, definition, "", count, ext, self)
