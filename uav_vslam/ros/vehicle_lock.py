# SPDX-License-Identifier: Apache-2.0
"""One launch a vehicle and computer: its checkpoint, live settings and pauses are files. Imports no ROS."""

import fcntl
import os
import sys
from collections.abc import Collection, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import IO

from uav_vslam.errors import ConfigError
from uav_vslam.slam.state_folder import state_folder


@contextmanager
def only_launch_of(vehicles: Collection[str]) -> Iterator[None]:
    """Hold vehicles, by name, for this process; the kernel releases them however it ends.

    Raises:
        ConfigError: another process holds one, or the state folder can't be written.
    """
    with ExitStack() as held:
        for vehicle in vehicles:
            _hold(vehicle, held.enter_context(_opened(state_folder() / f"{vehicle}.lock")))
        yield


def _opened(path: Path) -> IO[str]:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        return path.open("a+", encoding="utf-8")
    except OSError as error:
        raise ConfigError(
            f"{path} can't be written ({error.strerror}); set XDG_STATE_HOME to a folder that is writable"
        ) from None


def _hold(vehicle: str, file: IO[str]) -> None:
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        file.seek(0)
        raise ConfigError(
            f"{vehicle} already runs on this computer: process {file.read().strip()}; end that one, or set "
            f"XDG_STATE_HOME to another folder for this one, as both would write {vehicle}'s checkpoint"
        ) from None
    file.truncate(0)
    print(f"{os.getpid()} ({' '.join([Path(sys.argv[0]).name, *sys.argv[1:]])})", file=file, flush=True)
