# SPDX-License-Identifier: Apache-2.0
"""A node's module as a fork sees one: it tells who it is, and ends as its argument says."""

import os
import signal
import sys
from pathlib import Path


class Participant:
    """What only the garbage collector destroys."""

    def __init__(self) -> None:
        self.itself = self

    def __del__(self) -> None:
        """Tell of it."""
        print("destroyed")


def main() -> int:
    """Print name, group, title, variable, open files and the handling of SIGTERM; then end."""
    title = Path("/proc/self/cmdline").read_text().rstrip("\0")
    handled = signal.getsignal(signal.SIGTERM) is not signal.SIG_DFL
    files = sorted(int(fd) for fd in os.listdir("/proc/self/fd"))
    print(sys.argv[0], os.getpgid(0) == os.getpid(), title, os.environ.get("EXAMPLE"), files[:3], len(files), handled)
    print("to stderr", file=sys.stderr)
    if sys.argv[-1] == "kill":
        os.kill(os.getpid(), signal.SIGKILL)
    Participant()
    return int(sys.argv[-1])
