# SPDX-License-Identifier: Apache-2.0
"""Leaving a ROS domain, which Fast DDS may never end."""

import faulthandler
import signal
from collections.abc import Iterator
from contextlib import contextmanager

LEAVING_S = 3  # within the launcher's patience
STDERR = 2  # also where sys.stderr is no file
LEFT = signal.SIGALRM  # what ends a process that had nothing else to do


@contextmanager
def leaving(code: int = 0) -> Iterator[None]:
    """End this process if it does not leave its domain in time: by LEFT if all went well, otherwise with exit code 1.

    Fast DDS 2.14 destroys a participant with a lock that its callback about a participant that comes or goes may just
    then wait for, and waits for that callback. The interpreter's own lock is held meanwhile, so no handler is run.
    """
    before = signal.signal(LEFT, signal.SIG_DFL)
    if code:
        faulthandler.dump_traceback_later(LEAVING_S, exit=True, file=STDERR)
    else:
        signal.alarm(LEAVING_S)
    try:
        yield
    finally:
        signal.alarm(0)
        faulthandler.cancel_dump_traceback_later()
        signal.signal(LEFT, before)
