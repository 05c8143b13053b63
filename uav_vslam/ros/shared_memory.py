# SPDX-License-Identifier: Apache-2.0
"""Removes the shared memory that killed processes left: Fast DDS frees it only at an orderly exit. Imports no ROS.

A process holds a lock (flock) on `NAME_el` for each segment `fastrtps_<16 digits>` and for each port where it receives,
`fastrtps_port<number>`, as long as it lives. A file is left over if its lock is free; a port also has to be mapped by
nobody, for others may be about to send to it. The lock is held while the file is removed: a process that starts just
then takes another port.
"""

import fcntl
import os
import re
import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

FOLDER = Path("/dev/shm")
SEGMENT_BYTES = 35_127_840  # of a participant with config/dds/images.xml
SETTLED_S = 2.0  # a younger lock may be one that its process is about to take
_FILE = re.compile(r"(?:sem\.)?(fastrtps_(?:[0-9a-f]{16}|port\d+))(?:_el|_sl|_mutex)?")


@dataclass(frozen=True, slots=True)
class Removed:
    """What was removed.

    Attributes:
        names: segments and ports.
        size_bytes: memory that is free again.
    """

    names: tuple[str, ...] = ()
    size_bytes: int = 0


def lack_of_room(participants: int, folder: Path = FOLDER) -> str:
    """Return what to do about too little shared memory for so many participants; normally empty."""
    needed, free = participants * SEGMENT_BYTES, shutil.disk_usage(folder).free if folder.is_dir() else 0
    if free >= needed:
        return ""
    return (
        f"{folder} has {free / 1e6:.0f} MB free, and the nodes use up to {needed / 1e6:.0f} MB there: without, images "
        "go over UDP, which takes longer and loses some on a busy machine. Give it more (docker run --shm-size=1g)"
    )


def remove_leftovers(folder: Path = FOLDER) -> Removed:
    """Remove the files of Fast DDS that belong to no living process; other users' are left alone."""
    if not folder.is_dir():
        return Removed()
    names, size = [], 0
    with _locks(folder, sorted(_found(folder))) as locks:
        mapped = _mapped(folder)
        for name, made in locks.items():
            files = _files(folder, name)
            owner_is_dead = made is None and "port" not in name  # who still has its segment mapped keeps what is in it
            if owner_is_dead or mapped.isdisjoint(file.name for file in files):
                size += sum(_size(file) for file in files)
                names.append(name)
            else:
                files = [made] if made else []
            for file in files:
                file.unlink(missing_ok=True)
    return Removed(tuple(names), size)


def _found(folder: Path) -> set[str]:
    """Return the segments and ports of which any file is there and is ours."""
    found: dict[str, bool] = {}
    for entry in os.scandir(folder):
        match = _FILE.fullmatch(entry.name)
        if match:
            with suppress(OSError):  # gone
                found[match[1]] = found.get(match[1], True) and entry.stat().st_uid == os.geteuid()
    return {name for name, ours in found.items() if ours}


def _files(folder: Path, name: str) -> list[Path]:
    return [folder / file for file in (name, f"sem.{name}_mutex", f"{name}_sl", f"{name}_el")]


@contextmanager
def _locks(folder: Path, names: list[str]) -> Iterator[dict[str, Path | None]]:
    """Hold the locks of those names that nobody holds; with each, the lock's file if it had to be made."""
    held: list[int] = []
    try:
        found: dict[str, Path | None] = {}
        for name in names:
            exclusive, shared = folder / f"{name}_el", folder / f"{name}_sl"
            made = None if exclusive.exists() else exclusive  # its process has removed it, at an orderly exit
            if (not shared.exists() or _lock(shared, held)) and _lock(exclusive, held, make=made is not None):
                found[name] = made
        yield found
    finally:
        for descriptor in held:
            os.close(descriptor)


def _lock(path: Path, held: list[int], *, make: bool = False) -> bool:
    """Take a lock and return whether it was free; one that a starting process is about to take is not."""
    try:
        if not make and time.time() - path.stat().st_mtime < SETTLED_S:
            return False
        held.append(os.open(path, os.O_RDWR | (os.O_CREAT | os.O_EXCL if make else 0), 0o666))
        fcntl.flock(held[-1], fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return False
    return True


def _mapped(folder: Path) -> set[str]:
    """Return the names of the files in a folder that a process has mapped, as far as we may know."""
    prefix, found = f"{folder}/", set()
    for process in Path("/proc").iterdir():
        if process.name.isdigit():
            with suppress(OSError):  # gone, or another user's
                for line in (process / "maps").read_text(errors="replace").splitlines():
                    if prefix in line:
                        found.add(line.partition(prefix)[2].split(" ")[0])
    return found


def _size(file: Path) -> int:
    try:
        return file.stat().st_blocks * 512
    except OSError:
        return 0
