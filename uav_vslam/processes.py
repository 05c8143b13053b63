# SPDX-License-Identifier: Apache-2.0
"""Child processes that never outlive their parent, and the processor time that processes take."""

import ctypes
import multiprocessing
import os
import signal
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from uav_vslam.errors import WorkerEnded
from uav_vslam.memory import keep_freed_memory

_LIBC = ctypes.CDLL(None, use_errno=True)
_PR_SET_PDEATHSIG = 1
_UTIME, _STIME = 11, 12  # places in /proc/PID/stat after the program's name


def exit_with_parent(parent: int) -> None:
    """Let the kernel kill this process when its parent, with that pid, exits; Linux only."""
    if sys.platform != "linux":
        return
    _LIBC.prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:  # it exited before prctl took effect
        os._exit(1)


def ending_signals() -> list[signal.Signals]:
    """Return the signals that end this process: SIGHUP, of a terminal that closes, unless it runs under `nohup`."""
    ignored = signal.getsignal(signal.SIGHUP) == signal.SIG_IGN
    return [signal.SIGINT, signal.SIGTERM] if ignored else [signal.SIGINT, signal.SIGTERM, signal.SIGHUP]


def processor_time_s(pid: int) -> float:
    """Return the processor time that a process has used, user and system; Linux only [s].

    Raises:
        OSError: there is no such process any more.
    """
    fields = Path(f"/proc/{pid}/stat").read_text(encoding="ascii", errors="replace").rpartition(")")[2].split()
    return (int(fields[_UTIME]) + int(fields[_STIME])) / os.sysconf("SC_CLK_TCK")


@contextmanager
def worker_pool(
    workers: int, initializer: Callable[..., None] | None = None, *args: Any
) -> Iterator[ProcessPoolExecutor]:
    """Provide a pool of new processes that ignore SIGINT; this process handles it and terminates them at once.

    Args:
        workers: processes.
        initializer, args: called first in each worker, with these arguments.

    Raises:
        WorkerEnded: the system has ended a worker.
    """
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(workers, context, _initialize, (os.getpid(), initializer, args)) as pool:
        try:
            yield pool
        except BaseException as error:
            for process in multiprocessing.active_children():
                process.terminate()
            pool.shutdown(wait=False, cancel_futures=True)
            if isinstance(error, BrokenProcessPool):
                text = "a worker process was ended by the system, which does so where memory is short: use --workers 1"
                raise WorkerEnded(text) from None
            raise


def _initialize(parent: int, initializer: Callable[..., None] | None, args: tuple[Any, ...]) -> None:
    exit_with_parent(parent)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    keep_freed_memory()
    if initializer is not None:
        initializer(*args)
