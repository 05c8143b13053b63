# SPDX-License-Identifier: Apache-2.0
"""The number of this start of a vehicle: larger than that of every earlier one, even if the clock has stepped back.

Peers drop what an earlier session said once they know a later one, so a vehicle whose number fell behind would not be
heard. The last number is kept in a file; the clock alone would do only if it were always right, the file alone only if
it were never lost.
"""

import os
import time
from pathlib import Path

from uav_vslam.errors import ConfigError


def state_folder() -> Path:
    """Return where this user's programs keep what outlives them, by the XDG base directory specification."""
    return Path(os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state") / "uav_vslam"


def next_session(vehicle: str, *, folder: Path | None = None, now_s: float | None = None) -> int:
    """Return the number of a new session, max(last + 1, seconds since 1970), and remember it.

    Args:
        vehicle: name; each has a file of its own, `<vehicle>.session`.
        folder: where it is; `state_folder()` by default.
        now_s: time; the clock's by default [s].

    Raises:
        ConfigError: the file can't be read or written.
    """
    folder = folder or state_folder()
    path = folder / f"{vehicle}.session"
    clock = int(time.time() if now_s is None else now_s)
    try:
        session = max(_last(path) + 1, clock)
        folder.mkdir(parents=True, exist_ok=True)
        _replace(path, f"{session}\n")
    except OSError as error:
        raise ConfigError(
            f"{path}: the session's number can't be kept ({error.strerror}); set XDG_STATE_HOME to a folder that "
            "can be written, or the parameter session to a number larger than at the last start"
        ) from None
    return session


def _last(path: Path) -> int:
    """Return the number kept, or 0 where there is none or the file is damaged: then the clock has to do."""
    try:
        return int(path.read_text(encoding="ascii"))
    except (FileNotFoundError, ValueError):
        return 0


def _replace(path: Path, text: str) -> None:
    """Write a file whole or not at all, even if power fails."""
    new = path.with_name(f".{path.name}.{os.getpid()}")
    with new.open("w", encoding="ascii") as file:
        file.write(text)
        file.flush()
        os.fsync(file.fileno())
    new.replace(path)
    folder = os.open(path.parent, os.O_RDONLY)
    try:
        os.fsync(folder)
    finally:
        os.close(folder)
