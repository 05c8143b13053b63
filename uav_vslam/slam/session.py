# SPDX-License-Identifier: Apache-2.0
"""Session number of a vehicle's start: it always increases, even if the clock has stepped back.

Peers drop packets of earlier sessions, so a vehicle whose number decreased would be ignored. The last number is kept
in a file, and the clock is a second source: either may fail, a wrong clock or a lost file.
"""

import time
from pathlib import Path

from uav_vslam.errors import ConfigError
from uav_vslam.slam.state_folder import replace_file, state_folder


def next_session(vehicle: str, *, folder: Path | None = None, now_s: float | None = None) -> int:
    """Return the number of a new session, max(last + 1, seconds since 1970), and store it.

    Args:
        vehicle: name; each has its own file `<vehicle>.session`.
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
        replace_file(path, f"{session}\n".encode("ascii"))
    except OSError as error:
        raise ConfigError(
            f"{path}: the session number can't be stored ({error.strerror}); set XDG_STATE_HOME to a folder that "
            "is writable, or the parameter session to a number larger than at the last start"
        ) from None
    return session


def _last(path: Path) -> int:
    """Return the stored number, or 0 if missing or damaged: then the clock alone counts."""
    try:
        return int(path.read_text(encoding="ascii"))
    except (FileNotFoundError, ValueError):
        return 0
