# SPDX-License-Identifier: Apache-2.0
"""Writes bags from CDR bytes."""

import errno
import shutil
import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import TracebackType
from typing import Any, Self, cast

from rosbags.interfaces import (
    Connection,
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2.errors import WriterError
from rosbags.rosbag2.storage_mcap import McapWriter

from uav_vslam.datasets.cdr import definition, require_type
from uav_vslam.datasets.mcap_writer import Writer
from uav_vslam.datasets.retrying_file import RetryingFile
from uav_vslam.datasets.rosbag import require_sqlite_path
from uav_vslam.datasets.unindexed_mcap import readable_messages
from uav_vslam.errors import BagError

STORAGE = {"mcap": StoragePlugin.MCAP, "sqlite3": StoragePlugin.SQLITE3}
UNLIMITED = QosTime(9223372036, 854775807)  # how ROS writes "no deadline"


class RawRecorder:
    """Writes a bag from CDR bytes. A topic is declared by its first message.

    A context manager; on an error it removes the bag.

    Attributes:
        lost: messages that were taken, but that the file lacks because the disk was full at the end.
    """

    def __init__(self, path: Path, *, storage: str = "mcap", zstd: bool = False, retrying: bool = False) -> None:
        """Create the bag.

        Args:
            path: folder to make; it must not exist.
            storage: "mcap" or "sqlite3".
            zstd: compress the chunks of an mcap file, as `ros2 bag` can.
            retrying: go on when the disk is full: messages are refused until there is room again; mcap only.

        Raises:
            BagError: the folder exists or can't be made, or its name is none for this storage.
        """
        if storage not in STORAGE or (zstd and storage != "mcap"):
            raise BagError(
                f"bag storage {storage!r} can't be used; use mcap (compressed or not) or sqlite3 (uncompressed)"
            )
        if storage == "sqlite3":
            require_sqlite_path(path)
        self.path = path
        self._connections: dict[str, Connection] = {}
        self._taken = self.lost = 0
        try:
            self._writer = Writer(path, version=9, storage_plugin=STORAGE[storage])
            if zstd:
                self._writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
            self._writer.open()
            self._file = _made_retrying(self._writer) if retrying else None
        except OSError as error:
            raise BagError(f"can't record to {path}: {error.strerror}; choose another place") from None
        except (WriterError, sqlite3.OperationalError) as error:
            text = str(error).rstrip(".")
            raise BagError(f"can't record to {path}: {text}; choose a folder that does not exist yet") from None

    def write(
        self, topic: str, msgtype: str, data: bytes | memoryview, stamp_ns: int, *, latched: bool = False
    ) -> None:
        """Append one message.

        Args:
            topic: absolute name.
            msgtype: "sensor_msgs/msg/Imu".
            data: CDR bytes.
            stamp_ns: recording stamp [ns].
            latched: offer the topic as transient local; counts at its first message only.

        Raises:
            BagError: the type is not known, the topic already has another one, or a retrying bag's disk is full.
            OSError: the disk is full.
        """
        if self._file is not None and self.is_full():
            raise BagError(f"{self.path}: {self._file.error}; make room, recording then goes on")
        if topic not in self._connections:
            self._connections[topic] = self._connect(topic, msgtype, latched=latched)
        connection = self._connections[topic]
        if connection.msgtype != msgtype:
            raise BagError(f"{topic} was recorded as {connection.msgtype} and can't also hold {msgtype}")
        with self._naming_itself():
            self._writer.write(connection, stamp_ns, data)
        self._taken += 1

    def flush(self) -> None:
        """Write the messages of a retrying bag that wait in memory, which a process that is killed would lose."""
        storage = self._writer.storage
        if self._file is not None and isinstance(storage, McapWriter) and storage.chunk.msgs:
            storage.close_chunk()

    def is_full(self) -> bool:
        """Try to write what a retrying bag holds back, and return whether its disk is still full."""
        if self._file is not None:
            self._file.retry()
        return self._file is not None and self._file.full

    def close(self) -> None:
        """Write the index; nothing can be written afterwards.

        Raises:
            BagError: the disk of a retrying bag is full: the index is missing; what was recorded before can be read.
            OSError: the disk is full.
        """
        with self._naming_itself():
            try:
                self._writer.close()
            except OSError as error:
                if self._file is None:
                    raise
                self.lost = self._taken - self._readable()
                raise BagError(f"bag {self.path} has no end: {error}; what was recorded before can be read") from None

    def _readable(self) -> int:
        """Return how many messages can be read from a bag without an end."""
        count = 0
        with suppress(EOFError):
            for _ in readable_messages(self.path / f"{self.path.name}.mcap"):
                count += 1
        return count

    @contextmanager
    def _naming_itself(self) -> Iterator[None]:
        """Name the bag in errors of its file; SQLite has an error of its own for a full disk."""
        try:
            yield
        except OSError as error:
            raise OSError(error.errno, error.strerror, str(self.path)) from None
        except sqlite3.OperationalError as error:
            raise OSError(errno.ENOSPC, str(error), str(self.path)) from None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        complete = False
        try:
            self.close()
            complete = error is None
        finally:
            if not complete:  # an incomplete bag would pass for a short one
                shutil.rmtree(self.path)

    def _connect(self, topic: str, msgtype: str, *, latched: bool) -> Connection:
        require_type(msgtype)
        text, digest = definition(msgtype)
        return self._writer.add_connection(
            topic, msgtype, msgdef=text, rihs01=digest, offered_qos_profiles=[_qos(latched=latched)]
        )


def _made_retrying(writer: Writer) -> RetryingFile:
    """Let a writer of an mcap file outlive a full disk."""
    assert isinstance(writer.storage, McapWriter)
    file = RetryingFile(writer.storage.bio)
    writer.storage.bio = cast(Any, file)
    return file


def _qos(*, latched: bool) -> Qos:
    """Return the QoS that `ros2 bag play` offers: reliable, and transient local if latched."""
    return Qos(
        history=QosHistory.KEEP_LAST,
        depth=1 if latched else 10,
        reliability=QosReliability.RELIABLE,
        durability=QosDurability.TRANSIENT_LOCAL if latched else QosDurability.VOLATILE,
        deadline=UNLIMITED,
        lifespan=UNLIMITED,
        liveliness=QosLiveliness.AUTOMATIC,
        liveliness_lease_duration=UNLIMITED,
        avoid_ros_namespace_conventions=False,
    )
