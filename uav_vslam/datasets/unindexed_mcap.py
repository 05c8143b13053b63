# SPDX-License-Identifier: Apache-2.0
"""Reads an mcap file that is truncated or has a damaged index, which ordinary readers need.

Format: https://mcap.dev/spec. A file is magic bytes and records; a record is an opcode (1 byte), a length (8 bytes) and
a payload. Messages, and the schemas and channels they refer to, are in chunks, which may be compressed.
"""

import struct
from collections.abc import Iterator
from io import BytesIO
from mmap import ACCESS_READ, mmap
from pathlib import Path
from zlib import crc32

from mcap.data_stream import ReadDataStream
from mcap.records import Channel, Chunk, Schema
from mcap.stream_reader import get_chunk_data_stream

from uav_vslam.datasets.cdr import RawMessage
from uav_vslam.datasets.foreign_mcap import is_of_ros2

MAGIC = b"\x89MCAP0\r\n"
SCHEMA, CHANNEL, MESSAGE, CHUNK, DATA_END = 0x03, 0x04, 0x05, 0x06, 0x0F
RECORD_HEAD = struct.Struct("<BQ")
CHUNK_HEAD = struct.Struct("<QQQI")  # first stamp, last stamp, size, checksum; then the compression's name
MESSAGE_HEAD = struct.Struct("<HIQQ")  # channel, sequence, recording stamp, publishing stamp
END = struct.Struct("<QQI8s")  # where the index begins, and its own one; checksum from there to here; magic bytes
CHECKSUM = slice(-len(MAGIC) - 4, -len(MAGIC))  # of the index, in a file


def lacks_index(file: Path) -> bool:
    """Return whether a file is an mcap file without its end, or with an index that its checksum contradicts."""
    if file.suffix != ".mcap" or not file.is_file():
        return False
    if file.stat().st_size < END.size:
        return True
    with file.open("rb") as stream, mmap(stream.fileno(), 0, access=ACCESS_READ) as data:
        start, _, checksum, magic = END.unpack_from(data, len(data) - END.size)
        if magic != MAGIC or not checksum:  # zero: none was written
            return bool(magic != MAGIC)
        with memoryview(data) as whole, whole[start : CHECKSUM.start] as index:
            return crc32(index) != checksum


def readable_messages(file: Path) -> Iterator[RawMessage]:
    """Yield every complete message of ROS 2 in file order, then raise.

    Raises:
        EOFError: always, where the file or its messages end.
        ValueError: not an mcap file.
    """
    schemas: dict[int, Schema] = {}
    channels: dict[int, tuple[str, str, str]] = {}  # topic, type and its definition
    for opcode, payload in _records(file):
        if opcode == SCHEMA:
            read = Schema.read(ReadDataStream(BytesIO(payload)))
            schemas[read.id] = read
        elif opcode == CHANNEL:
            found = Channel.read(ReadDataStream(BytesIO(payload)))
            schema = schemas.get(found.schema_id)
            if schema is not None and is_of_ros2(found, schema):
                channels[found.id] = found.topic, schema.name, schema.data.decode(errors="replace")
        elif opcode == MESSAGE:
            number, _, stamp_ns, _ = MESSAGE_HEAD.unpack_from(payload)
            if number in channels:
                topic, msgtype, definition = channels[number]
                yield RawMessage(topic, msgtype, stamp_ns, payload[MESSAGE_HEAD.size :], definition)


def _records(file: Path) -> Iterator[tuple[int, bytes]]:
    """Yield (opcode, payload) of every complete record; chunks are replaced by the records inside."""
    with file.open("rb") as stream:
        if stream.read(len(MAGIC)) != MAGIC:
            raise ValueError("not an mcap file")
        while True:
            head = stream.read(RECORD_HEAD.size)
            if len(head) < RECORD_HEAD.size:
                raise EOFError("the file ends without an index")
            opcode, length = RECORD_HEAD.unpack(head)
            payload = stream.read(length)
            whole = len(payload) == length
            if opcode == DATA_END:
                raise EOFError("all messages are there, but the index after them is damaged")
            if opcode == CHUNK:
                yield from _chunk_records(payload, whole=whole)
            elif whole:
                yield opcode, payload
            if not whole:
                raise EOFError(f"the file ends at byte {stream.tell()}, inside a record")


def _chunk_records(payload: bytes, *, whole: bool) -> Iterator[tuple[int, bytes]]:
    if whole:
        stream, length = get_chunk_data_stream(Chunk.read(ReadDataStream(BytesIO(payload))), validate_crc=True)
        data = stream.read(length)
    elif len(payload) < CHUNK_HEAD.size + 12 or _string(payload, CHUNK_HEAD.size):
        return  # incomplete compressed data can't be read
    else:
        data = payload[CHUNK_HEAD.size + 12 :]
    at = 0
    while at + RECORD_HEAD.size <= len(data):
        opcode, length = RECORD_HEAD.unpack_from(data, at)
        at += RECORD_HEAD.size
        if at + length > len(data):
            return
        yield opcode, data[at : at + length]
        at += length


def _string(payload: bytes, at: int) -> str:
    length = int.from_bytes(payload[at : at + 4], "little")
    return payload[at + 4 : at + 4 + length].decode()
