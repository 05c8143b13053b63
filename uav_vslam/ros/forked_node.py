# SPDX-License-Identifier: Apache-2.0
"""A node's process as a fork of the supervisor, which has imported the nodes' libraries once for all of them.

Importing takes some two seconds of processor time, and a fleet has ten nodes; a fork takes milliseconds. So it does in
flight, where a node that died is started again.
"""

import contextlib
import ctypes
import gc
import os
import signal
import sys
import traceback
from collections.abc import Callable, Mapping, Sequence
from importlib import import_module
from typing import IO, NoReturn

from setproctitle import setproctitle

from uav_vslam.processes import exit_with_parent

STDIN, STDOUT, STDERR = 0, 1, 2
_PROGRAM = ctypes.c_char_p.in_dll(ctypes.CDLL(None), "program_invocation_name")  # ROS calls log files by it


class ForkedNode:
    """The process of a node: what the supervisor uses of a `subprocess.Popen`.

    Attributes:
        pid: its process, which leads a group of its own.
        stdout: the end to read of its output and errors.
        returncode: as of `subprocess.Popen`; None while it runs.
    """

    def __init__(self, module: str, arguments: Sequence[str], environment: Mapping[str, str]) -> None:
        """Start `main` of a node's module.

        Args:
            module: full name.
            arguments: of the command line.
            environment: variables in addition to ours.
        """
        main: Callable[[], int] = import_module(module).main
        gc.freeze()  # what is imported is never collected, and its memory stays shared
        reading, writing = os.pipe()
        parent = os.getpid()
        sys.stdout.flush()
        sys.stderr.flush()
        self.pid = os.fork()
        if self.pid == 0:
            _become(parent, writing, [module.rpartition(".")[2].removesuffix("_node"), *arguments], environment)
            _run(main)
        os.close(writing)
        self.stdout: IO[bytes] = os.fdopen(reading, "rb", buffering=0)
        self.returncode: int | None = None

    def poll(self) -> int | None:
        """Return the exit code, or minus the signal that killed the process; None while it runs."""
        if self.returncode is None:
            ended, status = os.waitpid(self.pid, os.WNOHANG)
            if ended:
                self.returncode = os.waitstatus_to_exitcode(status)
        return self.returncode


def _become(parent: int, output: int, argv: list[str], environment: Mapping[str, str]) -> None:
    """Be a process of its own: with no open file, signal handler or name of the supervisor."""
    os.setpgid(0, 0)
    exit_with_parent(parent)
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_DFL)
    os.dup2(os.open(os.devnull, os.O_RDONLY), STDIN)
    os.dup2(output, STDOUT)
    os.dup2(output, STDERR)
    os.closerange(STDERR + 1, os.sysconf("SC_OPEN_MAX"))
    sys.stdout, sys.stderr = (os.fdopen(fd, "w", buffering=1, closefd=False) for fd in (STDOUT, STDERR))
    os.environ.update(environment)
    sys.argv = argv
    setproctitle(" ".join(argv))
    _PROGRAM.value = argv[0].encode()


def _run(main: Callable[[], int]) -> NoReturn:
    """Run a node to its end, and never return to the supervisor's code."""
    code = 1
    try:
        code = int(main())
    except BaseException:
        traceback.print_exc()
    gc.collect()  # a DDS participant that is not destroyed leaves shared memory, and maybe a lock in it, to the others
    with contextlib.suppress(OSError):
        sys.stdout.flush()
    os._exit(code)
