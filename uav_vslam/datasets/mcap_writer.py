# SPDX-License-Identifier: Apache-2.0
"""rosbags' writer of mcap files, with the checksums that it leaves out: every reader then notices damage."""

from collections.abc import Callable, Mapping
from functools import partial
from io import BytesIO
from typing import Any, cast
from zlib import crc32

from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as BagWriter
from rosbags.rosbag2.storage_mcap import McapWriter

from uav_vslam.datasets.unindexed_mcap import CHECKSUM, END

OF_CHUNK = slice(33, 37)  # the checksum in a chunk's record, after opcode, length, two stamps and a size


class _ChecksummedWriter(McapWriter):
    """Writes one file."""

    def close_chunk(self) -> None:
        """Write the chunk and its index."""
        checksum = crc32(self.chunk.bio.getbuffer())
        written = self._written_by(super().close_chunk)
        written[OF_CHUNK] = checksum.to_bytes(4, "little")
        self.bio.write(written)

    def close(self, version: int, metadata: str) -> None:
        """Write metadata and index."""
        if self.chunk.bio.tell():
            self.close_chunk()
        begin = self.bio.tell()
        written = self._written_by(partial(super().close, version, metadata))
        start, *_ = END.unpack_from(written, len(written) - END.size)
        written[CHECKSUM] = crc32(written[start - begin : CHECKSUM.start]).to_bytes(4, "little")
        self.bio.write(written)
        self.bio.close()

    def _written_by(self, write: Callable[[], None]) -> memoryview:
        """Return what a method would write to the file."""
        file, buffer = self.bio, _FileAt(self.bio.tell())
        self.bio = cast(Any, buffer)
        try:
            write()
        finally:
            self.bio = file
        return buffer.getbuffer()


class _FileAt(BytesIO):
    """What is written to a file from a position on."""

    def __init__(self, position: int) -> None:
        super().__init__()
        self._position = position

    def tell(self) -> int:
        """Return the position in the file [bytes]."""
        return self._position + super().tell()

    def close(self) -> None:
        """Keep what was written."""


class Writer(BagWriter):
    """Writes bags."""

    STORAGE_PLUGINS: Mapping[StoragePlugin, Any] = {
        **BagWriter.STORAGE_PLUGINS,
        StoragePlugin.MCAP: _ChecksummedWriter,
    }
