# SPDX-License-Identifier: Apache-2.0
"""Files that outlive a process: where they are, and how they are replaced."""

import os
import tempfile
from pathlib import Path


def state_folder() -> Path:
    """Return the user's state folder, by the XDG base directory specification."""
    given = os.environ.get("XDG_STATE_HOME")
    if given:
        return Path(given) / "uav_vslam"
    try:
        return Path.home() / ".local" / "state" / "uav_vslam"
    except RuntimeError:  # a container's user without a home
        return Path(tempfile.gettempdir()) / "uav_vslam"


def replace_file(path: Path, content: bytes, *, durable: bool = True) -> None:
    """Replace a file of a folder atomically; a durable one even if power fails, which takes as long as the disk needs.

    Raises:
        OSError: it can't be written; the old one is still there.
    """
    new = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        with new.open("wb") as file:
            file.write(content)
            if durable:
                file.flush()
                os.fsync(file.fileno())
        new.replace(path)
    except OSError:
        new.unlink(missing_ok=True)
        raise
    if durable:
        _sync_folder(path.parent)


def _sync_folder(path: Path) -> None:
    folder = os.open(path, os.O_RDONLY)
    try:
        os.fsync(folder)
    finally:
        os.close(folder)
