# SPDX-License-Identifier: Apache-2.0
"""Starts, monitors and shuts down the processes of a fleet; imports no ROS.

Every process has its own process group, so that a terminal's Ctrl-C reaches the supervisor only; the kernel kills it if
the supervisor dies. One thread does everything: fork and signals stay simple.
"""

import contextlib
import os
import selectors
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, TextIO

from uav_vslam.errors import ConfigError
from uav_vslam.processes import ending_signals, exit_with_parent
from uav_vslam.ros.command import Command
from uav_vslam.ros.leaving import LEFT

DRAIN_S = 1.0  # after the replay's end, for messages in flight
ESCALATION = ((0.0, signal.SIGINT), (2.0, signal.SIGTERM), (4.0, signal.SIGKILL))  # seconds after the shutdown starts
SAVING = (*ESCALATION[:2], (60.0, signal.SIGKILL))  # where a process has a map to save
POLL_S = 0.05
BACKOFF_S = (0.2, 1.0, 2.0, 5.0, 10.0)  # before each restart of a process; the last one for all further ones
STABLE_S = 60.0  # a process that ran for so long is restarted without waiting again
WRONG_INPUT = 2  # exit code of a process that would fail again, if it comes soon after the first start


@dataclass(slots=True)
class _Child:
    """A command's process, which changes when it is restarted.

    Attributes:
        command, process: what runs.
        log: file of its output; None for none.
        unfinished: output after the last end of a line.
        started_s: when, by the monotonic clock [s].
        failures: in a row, none of which came after STABLE_S.
        restart_at_s: when it is due, by the same clock [s]; None unless it waits for its restart.
        restarted: it took the place of one that ended.
        missed: it is optional and failed; the fleet goes on.
    """

    command: Command
    process: subprocess.Popen[bytes]
    log: IO[bytes] | None
    unfinished: bytes = b""
    started_s: float = field(default_factory=time.monotonic)
    failures: int = 0
    restart_at_s: float | None = None
    restarted: bool = False
    missed: bool = False

    def has_refused(self, code: int) -> bool:
        """Return whether an exit code means that the input is wrong, and would be again.

        A process that has run before, or for long, had the right input: what it refuses then may come back, as a radio
        interface or room on the disk does.
        """
        return code == WRONG_INPUT and not self.restarted and time.monotonic() - self.started_s < STABLE_S


@dataclass(slots=True)
class Supervisor:
    """Runs commands until the leading one exits, one fails or a signal arrives.

    Attributes:
        restarts: a process that ends is started again, after a pause that grows, and the others go on.
        environment: variables in addition to ours.
        log_dir: folder for a log file of each process.
        escalation: what is sent to those that still run, and how many seconds after the order to end.
        on_line: called with (name, line) for all output; by default it is printed with its prefix.
    """

    environment: dict[str, str] = field(default_factory=dict)
    restarts: bool = False
    log_dir: Path | None = None
    on_line: Callable[[str, str], None] | None = None
    escalation: tuple[tuple[float, signal.Signals], ...] = ESCALATION
    _children: list[_Child] = field(default_factory=list)
    _selector: selectors.BaseSelector = field(default_factory=selectors.DefaultSelector)
    _signal: int = 0
    _code: int | None = None

    def run(self, commands: Iterable[Command]) -> int:
        """Run until the shutdown of all processes.

        Returns:
            The exit code of the first process that failed, or 0; 128 + the signal that ended the run before the
            leading process. Without a leading one, a signal is how a run ends.
        """
        before = {number: signal.signal(number, self._on_signal) for number in ending_signals()}
        try:
            for command in commands:
                self._children.append(self._start(command))
            while self._code is None and not self._signal:
                self._relay(POLL_S)
                self._watch()
        finally:
            self._shut_down()
            for number, handler in before.items():
                signal.signal(number, handler)
        return self._code or 0

    def _on_signal(self, number: int, _frame: object) -> None:
        self._signal = self._signal or number

    def _start(self, command: Command) -> _Child:
        log = self._open_log(command.name)
        child = _Child(command, self._spawn(command), log)
        self._follow(child)
        return child

    def _spawn(self, command: Command, more: Sequence[str] = ()) -> subprocess.Popen[bytes]:
        environment = os.environ | {"PYTHONUNBUFFERED": "1"} | self.environment | command.environment
        try:
            return subprocess.Popen(
                [*command.argv, *more],
                env=environment,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                process_group=0,
                preexec_fn=_child_setup(os.getpid()),
            )
        except OSError as error:
            raise ConfigError(f"{command.name} can't be started: {command.argv[0]}: {error.strerror}") from None

    def _follow(self, child: _Child) -> None:
        """Relay the output of a child's process."""
        assert child.process.stdout is not None
        os.set_blocking(child.process.stdout.fileno(), False)
        self._selector.register(child.process.stdout, selectors.EVENT_READ, child)

    def _open_log(self, name: str) -> IO[bytes] | None:
        if self.log_dir is None:
            return None
        path = self.log_dir / f"{name.replace('/', '_')}.log"
        try:
            self.log_dir.mkdir(parents=True, exist_ok=True)
            return path.open("wb", buffering=0)
        except OSError as error:
            raise ConfigError(f"{path}: no log can be kept there ({error.strerror}); choose another folder") from None

    def _relay(self, timeout_s: float) -> None:
        """Forward the processes' output."""
        if not self._selector.get_map():
            time.sleep(timeout_s)
        for key, _ in self._selector.select(timeout_s):
            child: _Child = key.data
            data = os.read(key.fd, 1 << 16)
            if not data:
                self._selector.unregister(key.fileobj)
            _write_log(child, data)
            *lines, child.unfinished = (child.unfinished + data).split(b"\n")
            if not data and child.unfinished:
                lines, child.unfinished = [child.unfinished], b""
            for line in lines:
                (self.on_line or print_line)(child.command.name, line.decode(errors="replace"))

    def _watch(self) -> None:
        """Detect the first process that has exited: a failure, unless it is the leading one."""
        for child in self._children:
            code = _exit_code(child.process)
            if code is None or self._is_missed(child, code) or self._is_restarted(child, code):
                continue
            if not child.command.leads or code != 0:
                _log(f"{child.command.name} {describe_exit(code)}; the fleet is shut down")
            self._code = _shell_code(code) if child.command.leads else _shell_code(code) or 1
            return

    def _is_missed(self, child: _Child, code: int) -> bool:
        """Go on without an optional process; return False for any other."""
        if not child.command.optional or child.has_refused(code):
            return False
        if not child.missed:
            _log(f"{child.command.name} {describe_exit(code)}; the fleet goes on without it")
        child.missed = True
        return True

    def _is_restarted(self, child: _Child, code: int) -> bool:
        """Restart a process that ended, when its time has come; return False if it is not to be restarted.

        Exit code 0 is no reason to let the others end: nobody but us should end a node, yet SIGTERM does so cleanly.
        """
        if not self.restarts or child.command.leads or child.has_refused(code):
            return False
        now_s = time.monotonic()
        if child.restart_at_s is None:
            child.failures = 0 if now_s - child.started_s > STABLE_S else child.failures
            pause_s = BACKOFF_S[min(child.failures, len(BACKOFF_S) - 1)]
            child.restart_at_s, child.failures = now_s + pause_s, child.failures + 1
            _log(f"{child.command.name} {describe_exit(code)}; it is restarted in {pause_s:g} s")
        elif now_s >= child.restart_at_s:
            self._forget(child)
            child.process = self._spawn(child.command, child.command.resume)
            self._follow(child)
            child.started_s, child.restart_at_s, child.restarted = now_s, None, True
        return True

    def _forget(self, child: _Child) -> None:
        """Close the output of a child's process that has exited; its last lines have been relayed during the pause."""
        pipe = child.process.stdout
        assert pipe is not None
        if pipe in {key.fileobj for key in self._selector.get_map().values()}:  # another process may still hold it
            self._selector.unregister(pipe)
        pipe.close()

    def _shut_down(self) -> None:
        """Signal the running processes, with escalation, and check their exit codes."""
        led = any(child.command.leads and child.process.poll() is not None for child in self._children)
        if led and not self._signal:
            self._relay_for(DRAIN_S)
        begin_s, steps = time.monotonic(), list(self.escalation)
        while any(child.process.poll() is None for child in self._children):
            while steps and time.monotonic() - begin_s >= steps[0][0]:
                self._send(steps.pop(0)[1])
            self._relay_for(POLL_S)
        self._relay_for(0.0)
        if self._signal and self._code is None:
            self._code = 128 + self._signal if any(child.command.leads for child in self._children) else 0
        self._check_exit_codes()
        for child in self._children:
            if child.process.stdout is not None:
                child.process.stdout.close()
            _close_log(child)
        self._selector.close()

    def _relay_for(self, duration_s: float) -> None:
        """Relay; a broken pipe or an error of `on_line` must not stop the shutdown."""
        end_s = time.monotonic() + duration_s
        while True:
            try:
                self._relay(min(POLL_S, duration_s))
            except (OSError, ValueError):
                time.sleep(min(POLL_S, duration_s))
            if time.monotonic() >= end_s or self._signal:
                return

    def _send(self, number: signal.Signals) -> None:
        for child in self._children:
            if child.process.poll() is None:
                if number == signal.SIGKILL:
                    _log(f"{child.command.name} does not exit; it is killed")
                early = number == signal.SIGINT and not _handles_sigterm(child.process.pid)
                os.killpg(child.process.pid, signal.SIGTERM if early else number)

    def _check_exit_codes(self) -> None:
        for child in self._children:
            code = _exit_code(child.process)
            if code and self._code == 0 and not child.missed and code not in {-signal.SIGINT, -signal.SIGTERM}:
                _log(f"{child.command.name} {describe_exit(code)} during shutdown")
                self._code = _shell_code(code)


def _write_log(child: _Child, data: bytes) -> None:
    """Write to a process's log file; a full disk ends the file, and nothing else."""
    try:
        if child.log is not None:
            child.log.write(data)
    except OSError as error:
        _log(f"the log file of {child.command.name} ends here: {error.strerror}")
        _close_log(child)


def _close_log(child: _Child) -> None:
    log, child.log = child.log, None
    with contextlib.suppress(OSError):  # the disk is full
        if log is not None:
            log.close()


def describe_exit(code: int) -> str:
    """Return "ended with exit code 3" or "was killed by SIGSEGV"."""
    return f"ended with exit code {code}" if code >= 0 else f"was killed by {signal.Signals(-code).name}"


def print_line(name: str, line: str) -> None:
    """Print a line of a process's output with its prefix."""
    _say(f"[{name}] {line}", sys.stdout)


def _handles_sigterm(pid: int) -> bool:
    """Return whether a process has installed its handlers; before that, SIGINT would only cause a traceback."""
    try:
        status = Path(f"/proc/{pid}/status").read_text(encoding="ascii", errors="replace")
    except OSError:
        return True
    caught = next((line.split()[1] for line in status.splitlines() if line.startswith("SigCgt:")), "0")
    return bool(int(caught, 16) >> (signal.SIGTERM - 1) & 1)


def _exit_code(process: subprocess.Popen[bytes]) -> int | None:
    """Return a process's exit code once it has ended; 0 too if it could not leave its ROS domain after all else."""
    code = process.poll()
    return 0 if code == -LEFT else code


def _shell_code(code: int) -> int:
    return code if code >= 0 else 128 - code


def _log(text: str) -> None:
    _say(f"uav-vslam: {text}", sys.stderr)


def _say(text: str, where: TextIO) -> None:
    """Print a line. It is lost where the terminal has closed or the disk is full: the fleet may be in flight.

    Raises:
        BrokenPipeError: the reader has closed the pipe, which ends the fleet as any command.
    """
    try:
        print(text, file=where, flush=True)
    except BrokenPipeError:
        raise
    except OSError:
        pass


def _child_setup(parent: int) -> Callable[[], None]:
    """Return the child's preexec function: exit with the parent, and restore the default SIGINT handler."""

    def prepare() -> None:
        exit_with_parent(parent)
        signal.signal(signal.SIGINT, signal.SIG_DFL)

    return prepare
