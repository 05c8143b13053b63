# SPDX-License-Identifier: Apache-2.0
"""rosbags' writer of mcap files, with the checksums of chunks that it leaves out: every reader then notices damage."""

from collections.abc import Mapping
from io import BytesIO
from typing import Any, cast
from zlib import crc32

from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as BagWriter
from rosbags.rosbag2.storage_mcap import McapWriter

CHECKSUM = slice(33, 37)  # in a chunk's record, after opcode, length, two stamps and a size


class _ChecksummedWriter(McapWriter):
    """Writes one file."""

    def close_chunk(self) -> None:
        """Write the chunk and its index."""
        checksum = crc32(self.chunk.bio.getbuffer())
        file, buffer = self.bio, _FileAt(self.bio.tell())
        self.bio = cast(Any, buffer)
        try:
            super().close_chunk()
        finally:
            self.bio = file
        written = buffer.getbuffer()
        written[CHECKSUM] = checksum.to_bytes(4, "little")
        file.write(written)


class _FileAt(BytesIO):
    """What is written to a file from a position on."""

    def __init__(self, position: int) -> None:
        super().__init__()
        self._position = position

    def tell(self) -> int:
        """Return the position in the file [bytes]."""
        return self._position + super().tell()


class Writer(BagWriter):
    """Writes bags."""

    STORAGE_PLUGINS: Mapping[StoragePlugin, Any] = {
        **BagWriter.STORAGE_PLUGINS,
        StoragePlugin.MCAP: _ChecksummedWriter,
    }
