# SPDX-License-Identifier: Apache-2.0
"""Starts the processes of a fleet, watches them and ends them together; imports no ROS.

Every process has its own process group, so that a terminal's Ctrl-C reaches the supervisor alone, and is killed by the
kernel if the supervisor dies without a chance to end it. One thread does it all: fork and signals stay simple.
"""

import os
import selectors
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO

from uav_vslam.errors import ConfigError
from uav_vslam.processes import exit_with_parent
from uav_vslam.ros.fleet_commands import NodeSpec

PACKAGE = "uav_vslam"
DRAIN_S = 1.0  # after the replay's end, for messages that are still under way
ESCALATION = ((0.0, signal.SIGINT), (2.0, signal.SIGTERM), (4.0, signal.SIGKILL))  # seconds after the order to end
POLL_S = 0.05


@dataclass(frozen=True, slots=True)
class Command:
    """One process to run.

    Attributes:
        name: prefix of its output.
        argv: program and arguments.
        leads: its end is the end of all; without it only a signal or a failure is.
    """

    name: str
    argv: list[str]
    leads: bool = False


@dataclass(slots=True)
class _Child:
    command: Command
    process: subprocess.Popen[bytes]
    log: IO[bytes] | None
    unfinished: bytes = b""


@dataclass(slots=True)
class Supervisor:
    """Runs commands until the leading one ends, one fails or a signal comes.

    Attributes:
        environment: variables that differ from ours.
        log_dir: also keep each process's output in a file here.
        escalation: what is sent to those that still run, and how many seconds after the order to end.
        on_line: called with (name, line) for all output; the default prints it with its prefix.
    """

    environment: dict[str, str] = field(default_factory=dict)
    log_dir: Path | None = None
    on_line: Callable[[str, str], None] | None = None
    escalation: tuple[tuple[float, signal.Signals], ...] = ESCALATION
    _children: list[_Child] = field(default_factory=list)
    _selector: selectors.BaseSelector = field(default_factory=selectors.DefaultSelector)
    _signal: int = 0
    _code: int | None = None

    def run(self, commands: Iterable[Command]) -> int:
        """Run to the end and leave nothing behind.

        Returns:
            0, the exit code of the first process that failed, or 128 + the signal that ended the run.
        """
        numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
        before = {number: signal.signal(number, self._on_signal) for number in numbers}
        try:
            for command in commands:
                self._children.append(self._start(command))
            while self._code is None and not self._signal:
                self._relay(POLL_S)
                self._watch()
        finally:
            self._end_all()
            for number, handler in before.items():
                signal.signal(number, handler)
        return self._code if self._code else 128 + self._signal if self._signal else 0

    def _on_signal(self, number: int, _frame: object) -> None:
        self._signal = self._signal or number

    def _start(self, command: Command) -> _Child:
        environment = os.environ | {"PYTHONUNBUFFERED": "1"} | self.environment
        try:
            process = subprocess.Popen(
                command.argv,
                env=environment,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                process_group=0,
                preexec_fn=_die_with(os.getpid()),
            )
        except OSError as error:
            raise ConfigError(f"{command.name} can't be started: {command.argv[0]}: {error.strerror}") from None
        child = _Child(command, process, self._open_log(command.name))
        assert process.stdout is not None
        os.set_blocking(process.stdout.fileno(), False)
        self._selector.register(process.stdout, selectors.EVENT_READ, child)
        return child

    def _open_log(self, name: str) -> IO[bytes] | None:
        if self.log_dir is None:
            return None
        self.log_dir.mkdir(parents=True, exist_ok=True)
        return (self.log_dir / f"{name.replace('/', '_')}.log").open("wb")

    def _relay(self, timeout_s: float) -> None:
        """Pass on what the processes have written."""
        if not self._selector.get_map():
            time.sleep(timeout_s)
        for key, _ in self._selector.select(timeout_s):
            child: _Child = key.data
            data = os.read(key.fd, 1 << 16)
            if not data:
                self._selector.unregister(key.fileobj)
            if child.log is not None:
                child.log.write(data)
            *lines, child.unfinished = (child.unfinished + data).split(b"\n")
            if not data and child.unfinished:
                lines, child.unfinished = [child.unfinished], b""
            for line in lines:
                (self.on_line or print_line)(child.command.name, line.decode(errors="replace"))

    def _watch(self) -> None:
        """Note the first process that has ended: the leading one may, any other has failed."""
        for child in self._children:
            code = child.process.poll()
            if code is None:
                continue
            if not child.command.leads or code != 0:
                _say(f"{child.command.name} {describe_exit(code)}; the fleet is ended")
            self._code = _shell_code(code) if child.command.leads else _shell_code(code) or 1
            return

    def _end_all(self) -> None:
        """End what still runs, ever more firmly, and take note of who fails at it."""
        led = any(child.command.leads and child.process.poll() is not None for child in self._children)
        if led and not self._signal:
            self._relay_for(DRAIN_S)
        begin_s, steps = time.monotonic(), list(self.escalation)
        while any(child.process.poll() is None for child in self._children):
            while steps and time.monotonic() - begin_s >= steps[0][0]:
                self._send(steps.pop(0)[1])
            self._relay_for(POLL_S)
        self._relay_for(0.0)
        self._judge_endings()
        for child in self._children:
            if child.process.stdout is not None:
                child.process.stdout.close()
            if child.log is not None:
                child.log.close()
        self._selector.close()

    def _relay_for(self, duration_s: float) -> None:
        """Relay, but let no broken pipe or error of `on_line` keep the processes alive."""
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
                    _say(f"{child.command.name} does not end; it is killed")
                early = number == signal.SIGINT and not _handles_sigterm(child.process.pid)
                os.killpg(child.process.pid, signal.SIGTERM if early else number)

    def _judge_endings(self) -> None:
        for child in self._children:
            code = child.process.returncode
            if self._code == 0 and code not in {0, -signal.SIGINT, -signal.SIGTERM}:
                _say(f"{child.command.name} {describe_exit(code)} while it was ended")
                self._code = _shell_code(code)


def node_command(spec: NodeSpec) -> Command:
    """Return the command that runs a node; its name is "uav1/slam_backend", or "replay" for the whole fleet."""
    name = f"{spec.namespace}/{spec.name}".strip("/")
    return Command(name, [*find_executable(spec.executable), *spec.ros_arguments()], leads=spec.executable == "replay")


def find_executable(name: str) -> list[str]:
    """Return how to start a node: the installed program as `ros2 run` finds it, or the module itself."""
    beside = [Path(sys.argv[0]).resolve().parent]
    prefixes = [Path(prefix) for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(":") if prefix]
    for folder in [*(prefix / "lib" / PACKAGE for prefix in prefixes), *beside]:
        if os.access(folder / name, os.X_OK) and (folder / name).is_file():
            return [str(folder / name)]
    return [sys.executable, "-m", f"{PACKAGE}.ros.{name}_node"]


def describe_exit(code: int) -> str:
    """Return "ended with exit code 3" or "was killed by SIGSEGV"."""
    return f"ended with exit code {code}" if code >= 0 else f"was killed by {signal.Signals(-code).name}"


def print_line(name: str, line: str) -> None:
    """Print a line of a process's output with its prefix."""
    print(f"[{name}] {line}", flush=True)


def _handles_sigterm(pid: int) -> bool:
    """Tell whether a process has set itself up; before that, SIGINT would only make Python print a traceback."""
    try:
        status = Path(f"/proc/{pid}/status").read_text(encoding="ascii", errors="replace")
    except OSError:
        return True
    caught = next((line.split()[1] for line in status.splitlines() if line.startswith("SigCgt:")), "0")
    return bool(int(caught, 16) >> (signal.SIGTERM - 1) & 1)


def _shell_code(code: int) -> int:
    return code if code >= 0 else 128 - code


def _say(text: str) -> None:
    print(f"uav-vslam: {text}", file=sys.stderr, flush=True)


def _die_with(parent: int) -> Callable[[], None]:
    """Return what a child does before it becomes its program: bind its life to ours, and take SIGINT again."""

    def prepare() -> None:
        exit_with_parent(parent)
        signal.signal(signal.SIGINT, signal.SIG_DFL)

    return prepare
