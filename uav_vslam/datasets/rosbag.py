# SPDX-License-Identifier: Apache-2.0
"""Bags as files: topics, raw messages and message types. Only this module and `ros1_bag` import `rosbags`.

A damaged recording (its writer was killed, or the file is truncated) is read up to the damage; then `BagError` follows.
"""

import errno
import heapq
import os
import shutil
import sqlite3
import sys
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import cache
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
from rosbags.rosbag2 import CompressionFormat, CompressionMode, Reader, StoragePlugin, Writer
from rosbags.rosbag2.errors import WriterError
from rosbags.rosbag2.storage_mcap import McapWriter
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from uav_vslam.datasets import ros1_bag
from uav_vslam.datasets.compressed_bag import compressed_files, unpacked
from uav_vslam.datasets.retrying_file import RetryingFile
from uav_vslam.datasets.truncated_mcap import is_truncated, readable_messages
from uav_vslam.errors import BagError, one_line

MESSAGE_PACKAGE = "uav_vslam_msgs"
STORAGE = {"mcap": StoragePlugin.MCAP, "sqlite3": StoragePlugin.SQLITE3}
STORAGE_FILES = (".mcap", ".db3", ros1_bag.SUFFIX)
PICTURES = (".jpg", ".jpeg", ".png", ".tif", ".tiff")
DATA_SETS = ("mav0", "cam0", "image_0")  # folders inside of EuRoC's and KITTI's
UNLIMITED = QosTime(9223372036, 854775807)  # how ROS writes "no deadline"


@dataclass(frozen=True, slots=True)
class TopicInfo:
    """A topic of a recording.

    Attributes:
        msgtype: "sensor_msgs/msg/Imu".
        count: messages recorded.
        latched: offered with transient-local durability, for late subscribers.
    """

    msgtype: str
    count: int
    latched: bool


@dataclass(frozen=True, slots=True)
class RawMessage:
    """A message as it was recorded; one of ROS 1 as ROS 2 has it.

    Attributes:
        topic, msgtype: name and type.
        stamp_ns: when it was recorded [ns].
        data: CDR bytes.
    """

    topic: str
    msgtype: str
    stamp_ns: int
    data: bytes


@cache
def typestore() -> Typestore:
    """Return Jazzy's message types and our own, if their definitions are found."""
    store = get_typestore(Stores.ROS2_JAZZY)
    types: dict[str, Any] = {}
    for path in sorted(_message_folder().glob("*.msg")):
        types.update(get_types_from_msg(path.read_text(encoding="utf-8"), f"{MESSAGE_PACKAGE}/msg/{path.stem}"))
    store.register(types)
    return store


def message(msgtype: str, **fields: Any) -> Any:
    """Build a message; `fields` must be all of its fields.

    Raises:
        BagError: the type is not known.
    """
    _require_type(msgtype)
    return typestore().types[msgtype](**fields)


def encode(built: Any) -> bytes:
    """Return the CDR bytes of a message made by `message`."""
    return bytes(encoded_view(built))


def encoded_view(built: Any) -> memoryview:
    """Return the same without a copy, to be written at once."""
    return typestore().serialize_cdr(built, built.__msgtype__)


@cache
def _definition(msgtype: str) -> tuple[str, str]:
    """Return text and hash of a type's definition, which take milliseconds to make."""
    text, _ = typestore().generate_msgdef(msgtype, ros_version=2)
    return text, typestore().hash_rihs01(msgtype)


def decode(raw: RawMessage) -> Any:
    """Return the message object of recorded bytes.

    Raises:
        BagError: the type is not known or the bytes do not fit it.
    """
    _require_type(raw.msgtype)
    try:
        return typestore().deserialize_cdr(raw.data, raw.msgtype)
    except Exception as error:  # rosbags' generated code raises many kinds of errors on wrong bytes
        raise BagError(f"{raw.topic} at {raw.stamp_ns} ns: not a valid {raw.msgtype} ({error})") from None


def topics_of(paths: Sequence[Path]) -> dict[str, TopicInfo]:
    """Return the topics of one or more bags together.

    Raises:
        BagError: a path is missing or not a bag.
    """
    topics: dict[str, TopicInfo] = {}
    for file in _files(paths):
        for topic, info in _topics_of_file(file).items():
            known = topics.get(topic, TopicInfo(info.msgtype, 0, info.latched))
            topics[topic] = TopicInfo(info.msgtype, known.count + info.count, info.latched)
    return topics


def iter_raw(paths: Sequence[Path], topics: Sequence[str] | None = None) -> Iterator[RawMessage]:
    """Yield the recorded messages of one or more bags in the order of their recording stamps.

    Args:
        paths: bag folders or storage files (mcap, sqlite3, ROS 1's .bag).
        topics: only these; None for all.

    Raises:
        BagError: a path is missing or not a bag, or a bag is damaged (raised after all readable messages).
    """
    wanted = None if topics is None else frozenset(topics)
    streams = [_messages_of_file(file, wanted) for file in _files(paths)]
    yield from heapq.merge(*streams, key=lambda raw: raw.stamp_ns)


class RawRecorder:
    """Writes a bag from CDR bytes. A topic is declared by its first message.

    A context manager; on an error it removes the bag.
    """

    def __init__(self, path: Path, *, storage: str = "mcap", zstd: bool = False, retrying: bool = False) -> None:
        """Create the bag.

        Args:
            path: folder to make; it must not exist.
            storage: "mcap" or "sqlite3".
            zstd: compress the chunks of an mcap file, as `ros2 bag` can.
            retrying: go on when the disk is full: messages are refused until there is room again; mcap only.

        Raises:
            BagError: the folder exists or can't be made.
        """
        if storage not in STORAGE or (zstd and storage != "mcap"):
            raise BagError(
                f"bag storage {storage!r} can't be used; use mcap (compressed or not) or sqlite3 (uncompressed)"
            )
        self.path = path
        self._connections: dict[str, Connection] = {}
        try:
            self._writer = Writer(path, version=9, storage_plugin=STORAGE[storage])
            if zstd:
                self._writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
            self._writer.open()
            self._file = _made_retrying(self._writer) if retrying else None
        except (WriterError, OSError, sqlite3.OperationalError) as error:
            raise BagError(f"can't record to {path}: {error}; choose a folder that does not exist yet") from None

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
                raise BagError(f"bag {self.path} has no end: {error}; what was recorded before can be read") from None

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
        _require_type(msgtype)
        text, digest = _definition(msgtype)
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


def _message_folder() -> Path:
    """Return the folder of our .msg files: beside the sources, or where colcon or pip installed them."""
    prefixes = [Path(p) for p in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if p]
    candidates = [Path(__file__).resolve().parents[2] / MESSAGE_PACKAGE / "msg"]
    candidates += [prefix / "share" / MESSAGE_PACKAGE / "msg" for prefix in [*prefixes, Path(sys.prefix)]]
    return next((folder for folder in candidates if folder.is_dir()), candidates[0])


def _require_type(msgtype: str) -> None:
    if msgtype not in typestore().types:
        hint = "build it and source its workspace" if msgtype.startswith(MESSAGE_PACKAGE) else "use a Jazzy type"
        raise BagError(f"message type {msgtype} is not known; {hint} (searched {_message_folder()})")


def _hint(path: Path) -> str:
    """Return what to do with a path that is no bag, if that is plain."""
    if any((path / name).is_dir() for name in DATA_SETS):
        return "; import it: uav-vslam import --help"
    if path.is_dir() and any(file.suffix.lower() in PICTURES for file in path.iterdir()):
        return f"; it holds pictures, which are joined by: uav-vslam mosaic {path}"
    return ""


def _files(paths: Sequence[Path]) -> list[Path]:
    """Return the paths to open: bag folders with metadata, or the storage files of those without; all unpacked."""
    files: list[Path] = []
    for path in map(Path, paths):
        if not path.exists():
            raise BagError(f"bag {path} does not exist; give a bag folder or an .mcap, .db3 or .bag file")
        if compressed_files(path):
            path = unpacked(path)
        files_inside = sorted(p for p in path.iterdir() if p.suffix in STORAGE_FILES) if path.is_dir() else [path]
        if not files_inside or (path.is_file() and path.suffix not in STORAGE_FILES):
            raise BagError(
                f"{path} is not a bag: no .mcap, .db3 or .bag file; give a bag folder or such a file{_hint(path)}"
            )
        whole = path.is_dir() and (path / "metadata.yaml").exists() and not any(map(is_truncated, files_inside))
        files += [path] if whole else files_inside
    return files


def _topics_of_file(file: Path) -> dict[str, TopicInfo]:
    if is_truncated(file):
        return _topics_of_truncated_file(file)
    if file.suffix == ros1_bag.SUFFIX:
        return _topics_of_ros1_file(file)
    with ExitStack() as stack:
        reader = _open(file, stack)
        topics: dict[str, TopicInfo] = {}
        for connection in reader.connections:
            profiles = getattr(connection.ext, "offered_qos_profiles", [])
            latched = any(qos.durability == QosDurability.TRANSIENT_LOCAL for qos in profiles)
            count = connection.msgcount + (topics[connection.topic].count if connection.topic in topics else 0)
            topics[connection.topic] = TopicInfo(connection.msgtype, count, latched)
        return topics


def _messages_of_file(file: Path, topics: frozenset[str] | None) -> Iterator[RawMessage]:
    last_ns: int | None = None
    read = _messages_of_truncated_file if is_truncated(file) else _messages_of_whole_file
    read = _messages_of_ros1_file if file.suffix == ros1_bag.SUFFIX else read
    try:
        for raw in read(file, topics):
            last_ns = raw.stamp_ns
            yield raw
    except BagError:
        raise
    except Exception as error:  # struct, sqlite, zstd, index errors, depending on the damage
        raise _damage(file, last_ns, error) from None


def _damage(file: Path, last_ns: int | None, error: Exception) -> BagError:
    reached = "nothing could be read" if last_ns is None else f"read up to the damage after stamp {last_ns} ns"
    return BagError(f"bag {file} is damaged: {reached} ({one_line(error)}); record it again or use the readable part")


def _messages_of_whole_file(file: Path, topics: frozenset[str] | None) -> Iterator[RawMessage]:
    with ExitStack() as stack:
        reader = _open(file, stack)
        wanted = [c for c in reader.connections if topics is None or c.topic in topics]
        if wanted:  # an empty list would mean all
            for connection, stamp_ns, data in reader.messages(wanted):
                yield RawMessage(connection.topic, connection.msgtype, stamp_ns, bytes(data))


def _messages_of_ros1_file(file: Path, topics: frozenset[str] | None) -> Iterator[RawMessage]:
    for topic, msgtype, stamp_ns, data in ros1_bag.messages(file, topics, encode, typestore()):
        yield RawMessage(topic, msgtype, stamp_ns, data)


def _topics_of_ros1_file(file: Path) -> dict[str, TopicInfo]:
    topics: dict[str, TopicInfo] = {}
    try:
        for topic, msgtype, count, latched in ros1_bag.topics(file):
            known = topics.get(topic, TopicInfo(msgtype, 0, latched))
            topics[topic] = TopicInfo(msgtype, known.count + count, latched or topic.endswith("tf_static"))
    except Exception as error:  # struct and format errors, depending on the damage
        raise _damage(file, None, error) from None
    return topics


def _open(file: Path, stack: ExitStack) -> Reader:
    try:
        return stack.enter_context(Reader(file))
    except Exception as error:  # yaml, sqlite and struct errors, depending on the damage
        raise _damage(file, None, error) from None


def _messages_of_truncated_file(file: Path, topics: frozenset[str] | None) -> Iterator[RawMessage]:
    for found in readable_messages(file):
        if topics is None or found.topic in topics:
            yield RawMessage(found.topic, found.msgtype, found.stamp_ns, found.data)


def _topics_of_truncated_file(file: Path) -> dict[str, TopicInfo]:
    topics: dict[str, TopicInfo] = {}
    try:
        for raw in _messages_of_truncated_file(file, None):
            count = topics[raw.topic].count if raw.topic in topics else 0
            topics[raw.topic] = TopicInfo(raw.msgtype, count + 1, raw.topic.endswith(("tf_static", "initial_state")))
    except Exception as error:  # a truncated file always ends in one
        if not topics:
            raise _damage(file, None, error) from None
    return topics
