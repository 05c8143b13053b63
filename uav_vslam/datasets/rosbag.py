# SPDX-License-Identifier: Apache-2.0
"""Reads bags as files: topics, and messages as they were recorded.

A damaged recording (its writer was killed, or the file is truncated) is read up to the damage; then `BagError` follows.
"""

import heapq
import re
from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from shlex import join, quote
from typing import Generic, TypeVar

from rosbags.interfaces import Connection, QosDurability

from uav_vslam.datasets import ros1_bag
from uav_vslam.datasets.bag_reader import Reader
from uav_vslam.datasets.cdr import RawMessage, encode, typestore
from uav_vslam.datasets.compressed_bag import METADATA, SUFFIX, compressed_files, given_as, unpacked, unpacked_message
from uav_vslam.datasets.foreign_mcap import what_is_foreign
from uav_vslam.datasets.unindexed_mcap import lacks_index, readable_messages
from uav_vslam.errors import BagError, one_line

Item = TypeVar("Item")

STORAGE_FILES = (".mcap", ".db3", ros1_bag.SUFFIX)
UNFINISHED = f"{ros1_bag.SUFFIX}.active"  # how a recorder of ROS 1 calls a bag before its end
RESULTS = ("summary.json", "study.json", "mosaic.json", "comparison.json")
PICTURES = (".jpg", ".jpeg", ".png", ".tif", ".tiff")
URI = re.compile(r"[#?]|%[0-9a-fA-F]{2}")  # what SQLite, which rosbags gives a URI, takes for more than a name
FOREIGN_REMEDY = "give one with the profile ros2 and all messages in CDR, as `ros2 bag record -s mcap` writes it"
MERGE = "`sqlite3 %s 'PRAGMA wal_checkpoint(TRUNCATE)'` moves them into it"
DATA_SETS = ("mav0", "cam0", "image_0", "image_00")  # folders inside of EuRoC's and KITTI's


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


class Topics(dict[str, TopicInfo]):
    """The topics of recordings, by name.

    Attributes:
        foreign: encodings of those that are left out because their messages are not of ROS 2: "protobuf".
    """

    def __init__(self) -> None:
        super().__init__()
        self.foreign: dict[str, str] = {}

    def count(self, topic: str, msgtype: str, messages: int, *, latched: bool) -> None:
        """Count messages of a topic; type and durability are those of the last ones."""
        name = _full_name(topic)
        self[name] = TopicInfo(msgtype, messages + (self[name].count if name in self else 0), latched)


def is_bag(path: Path) -> bool:
    """Return whether a path is meant as a bag, by its name or those of the files inside."""
    files = list(path.iterdir()) if path.is_dir() else [path]
    return any(file.name == METADATA or file.name.removesuffix(SUFFIX).endswith(STORAGE_FILES) for file in files)


def topics_of(paths: Sequence[Path]) -> Topics:
    """Return the topics of one or more bags together.

    Raises:
        BagError: a path is missing or not a bag.
    """
    topics = Topics()
    for file in _files(paths):
        if lacks_index(file):
            _survey_unindexed_file(file, topics)
        elif file.suffix == ros1_bag.SUFFIX:
            _survey_ros1_file(file, topics)
        else:
            _survey_whole_file(file, topics)
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
    streams = [UpToDamage(_messages_of_file(file, wanted)) for file in _files(paths)]
    yield from heapq.merge(*streams, key=lambda raw: raw.stamp_ns)
    for stream in streams:
        if stream.error:
            raise stream.error


class UpToDamage(Generic[Item]):
    """What can be read of damaged bags, and the error that follows."""

    def __init__(self, items: Iterable[Item]) -> None:
        self._items = items
        self.error: BagError | None = None

    def __iter__(self) -> Iterator[Item]:
        try:
            yield from self._items
        except BagError as error:
            self.error = error


def iter_readable(paths: Sequence[Path], topics: Sequence[str]) -> Iterator[RawMessage]:
    """Yield the readable messages of some topics; damage is ignored, because `iter_raw` reports it at the replay."""
    return iter(UpToDamage(iter_raw(paths, topics)))


def require_sqlite_path(path: Path) -> None:
    """Refuse the path of a sqlite3 bag that SQLite would read as another one.

    Raises:
        BagError: it would.
    """
    if found := URI.search(str(path)):
        raise BagError(f"{path}: SQLite takes {found[0]} for no part of a name; choose a path without, or use mcap")


def names_of(paths: Sequence[Path]) -> str:
    """Return the bags' paths as an error names them."""
    return ", ".join(map(str, paths))


def _hint(path: Path) -> str:
    """Return what to do with a path that is no bag, if that is plain."""
    unfinished = sorted(path.glob(f"*{UNFINISHED}")) if path.is_dir() else [path] * path.name.endswith(UNFINISHED)
    if unfinished:
        whole = unfinished[0].with_suffix("")
        return (
            f"; {unfinished[0].name} was not completed: `rosbag reindex` of ROS 1 repairs it, then call it {whole.name}"
        )
    if any((path / name).is_dir() for name in DATA_SETS):
        return "; import it: uav-vslam import --help"
    if any((path / name).is_file() for name in RESULTS):
        return "; it holds results: name the recording, or see uav-vslam map, evaluate, export and report"
    if path.is_dir() and any(file.suffix.lower() in PICTURES for file in path.iterdir()):
        return f"; it holds pictures, which are joined by: uav-vslam mosaic {quote(str(path))}"
    if path.is_dir() and (bags := sorted(file.parent for end in STORAGE_FILES for file in path.glob(f"*/*{end}"))):
        return f"; those of one flight are given together: {join(map(str, dict.fromkeys(bags)))}"
    return ""


def _files(paths: Sequence[Path]) -> list[Path]:
    """Return the paths to open: bag folders with metadata, or the storage files of those without; all unpacked.

    Raises:
        BagError: a path is missing, not a bag, or holds what an earlier one holds: its messages would count twice.
    """
    files: list[Path] = []
    owners: dict[Path, Path] = {}  # of the storage files
    for given in map(Path, paths):
        path = given
        if not path.exists():
            raise BagError(f"bag {path} does not exist; give a bag folder or an .mcap, .db3 or .bag file")
        if compressed_files(path):
            path = unpacked(path)
        files_inside = sorted(p for p in path.iterdir() if p.suffix in STORAGE_FILES) if path.is_dir() else [path]
        if not files_inside or (path.is_file() and path.suffix not in STORAGE_FILES):
            raise BagError(
                f"{path} is not a bag: no .mcap, .db3 or .bag file; give a bag folder or such a file{_hint(path)}"
            )
        for file in files_inside:
            if file.suffix == ".db3":
                require_sqlite_path(file)
        for real in map(Path.resolve, files_inside):
            if real in owners:
                raise BagError(f"bag {given} holds what {owners[real]} holds, {real.name}: give each recording once")
            owners[real] = given
        whole = path.is_dir() and (path / METADATA).exists() and not any(map(lacks_index, files_inside))
        files += [path] if whole else files_inside
    return files


def _survey_whole_file(file: Path, topics: Topics) -> None:
    with ExitStack() as stack:
        reader = _open(file, stack)
        for connection in _connections(reader):
            profiles = getattr(connection.ext, "offered_qos_profiles", [])
            latched = any(qos.durability == QosDurability.TRANSIENT_LOCAL for qos in profiles)
            topics.count(connection.topic, connection.msgtype, connection.msgcount, latched=latched)
        for mcap in reader.mcap_files:
            topics.foreign |= {_full_name(topic): encoding for topic, encoding in mcap.foreign.items()}


def _messages_of_file(file: Path, topics: frozenset[str] | None) -> Iterator[RawMessage]:
    last_ns: int | None = None
    read = _messages_of_unindexed_file if lacks_index(file) else _messages_of_whole_file
    read = _messages_of_ros1_file if file.suffix == ros1_bag.SUFFIX else read
    try:
        for raw in read(file, topics):
            last_ns = raw.stamp_ns
            data = unpacked_message(raw.data)
            yield raw if data is raw.data else replace(raw, data=data)
    except BagError:
        raise
    except Exception as error:  # struct, sqlite, zstd, index errors, depending on the damage
        raise _damage(file, last_ns, error) from None


def _damage(file: Path, last_ns: int | None, error: Exception) -> BagError:
    reached, remedy = "nothing could be read", "record it again, or give the right file"
    if last_ns is not None:
        reached = f"read up to the damage after stamp {last_ns} ns"
        remedy = "record it again or use the readable part"
    if last_ns is None and file.suffix == ros1_bag.SUFFIX:  # the index is at the end of such a file
        remedy = "restore its index by `rosbag reindex` of ROS 1, or record it again"
    if log := _write_ahead_log(file):
        remedy = f"its messages are in {log.name}: {MERGE % quote(str(file))}"
    if last_ns is None and file.is_dir():
        remedy = "record it again, or correct its metadata.yaml or remove it: the files that are there are then read"
    return BagError(f"bag {given_as(file)} is damaged: {reached} ({one_line(error)}); {remedy}")


def _messages_of_whole_file(file: Path, topics: frozenset[str] | None) -> Iterator[RawMessage]:
    with ExitStack() as stack:
        reader = _open(file, stack)
        wanted = [c for c in _connections(reader) if topics is None or _full_name(c.topic) in topics]
        if wanted:  # an empty list would mean all
            for connection, stamp_ns, data in reader.messages(wanted):
                recorded = connection.msgdef.data
                yield RawMessage(_full_name(connection.topic), connection.msgtype, stamp_ns, bytes(data), recorded)
        if damage := [one for file in reader.mcap_files for one in file.damage]:
            raise BagError(
                f"bag {given_as(file)} is damaged: {len(damage)} of its chunks can't be read and were left out, the "
                f"first {damage[0]}; record it again or use the readable part"
            )
        for storage in reader.storages:
            if log := _write_ahead_log(storage.path):
                raise BagError(
                    f"bag {given_as(file)} is not whole: its last messages are in {log}; "
                    f"{MERGE % quote(str(storage.path))}"
                )


def _write_ahead_log(file: Path) -> Path | None:
    """Return the log of a sqlite3 file that holds what its recorder, killed, did not move into it; None without one."""
    log = file.with_name(f"{file.name}-wal")
    return log if file.suffix == ".db3" and log.exists() and log.stat().st_size > 0 else None


def _full_name(topic: str) -> str:
    """Return a topic's name with the slash that bags made without ROS may lack: a relative one is of no namespace."""
    return topic if topic.startswith("/") else f"/{topic}"


def _connections(reader: Reader) -> list[Connection]:
    """Return the connections that the storage files hold: of those in metadata.yaml, others' QoS gives no message."""
    return [connection for storage in reader.storages for connection in storage.connections]


def _messages_of_ros1_file(file: Path, topics: frozenset[str] | None) -> Iterator[RawMessage]:
    wanted = None if topics is None else topics | {topic.removeprefix("/") for topic in topics}
    for topic, msgtype, stamp_ns, data in ros1_bag.messages(file, wanted, encode, typestore()):
        yield RawMessage(_full_name(topic), msgtype, stamp_ns, data)


def _survey_ros1_file(file: Path, topics: Topics) -> None:
    try:
        for topic, msgtype, messages, latched in ros1_bag.topics(file):
            topics.count(topic, msgtype, messages, latched=latched or topic.endswith("tf_static"))
    except Exception as error:  # struct and format errors, depending on the damage
        raise _damage(file, None, error) from None


def _open(file: Path, stack: ExitStack) -> Reader:
    try:
        return stack.enter_context(Reader(file))
    except Exception as error:  # yaml, sqlite and struct errors, depending on the damage
        for mcap in sorted(file.glob("*.mcap")) if file.is_dir() else [file]:
            if mcap.suffix == ".mcap" and (foreign := what_is_foreign(mcap)):
                raise BagError(f"{mcap} is not of ROS 2: {foreign}; {FOREIGN_REMEDY}") from None
        raise _damage(file, None, error) from None


def _messages_of_unindexed_file(file: Path, topics: frozenset[str] | None) -> Iterator[RawMessage]:
    for raw in readable_messages(file):
        topic = _full_name(raw.topic)
        if topics is None or topic in topics:
            yield raw if topic == raw.topic else replace(raw, topic=topic)


def _survey_unindexed_file(file: Path, topics: Topics) -> None:
    raw = None
    try:
        for raw in readable_messages(file):
            topics.count(raw.topic, raw.msgtype, 1, latched=raw.topic.endswith(("tf_static", "initial_state")))
    except Exception as error:  # reading always ends in one
        if raw is None:
            raise _damage(file, None, error) from None
