# SPDX-License-Identifier: Apache-2.0
"""The command finds its verbs, imports no more than it needs, and turns errors into one line and an exit code."""

import argparse
import contextlib
import os
import signal
import subprocess
import sys
import types
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import uav_vslam
from uav_vslam.cli import main as command
from uav_vslam.errors import BagError

Install = Callable[[Callable[[argparse.Namespace], int]], None]
Handlers = dict[int, Any]


@pytest.fixture
def install(monkeypatch: pytest.MonkeyPatch) -> Install:
    """Make `bench` a verb that does what the test says."""

    def replace(run: Callable[[argparse.Namespace], int]) -> None:
        module = types.ModuleType("uav_vslam.cli.bench")
        module.HELP = "do what the test says"
        module.add_arguments = lambda parser: parser.add_argument("--times", type=int, default=1)
        module.run = run
        monkeypatch.setitem(sys.modules, "uav_vslam.cli.bench", module)

    return replace


@pytest.fixture
def handlers() -> Iterator[Handlers]:
    """Return the handlers of signals, and set them again afterwards: the command leaves them to a process that ends."""
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    yield before
    for number, handler in before.items():
        signal.signal(number, handler)


def test_the_interpreter_runs_the_command_as_a_module(tmp_path: Path) -> None:
    command_line = [sys.executable, "-m", "uav_vslam", "evaluate", str(tmp_path / "nowhere")]
    ended = subprocess.run(command_line, capture_output=True, text=True, timeout=60, check=False)
    assert ended.returncode == 2
    assert ended.stderr.startswith("uav-vslam: ")
    assert "nowhere" in ended.stderr


def test_the_verbs_exit_code_is_the_commands(install: Install) -> None:
    install(lambda args: args.times)
    assert command.main(["bench", "--times", "3"]) == 3


def test_our_errors_are_one_line_and_exit_code_2(install: Install, capsys: pytest.CaptureFixture[str]) -> None:
    def fail(_: argparse.Namespace) -> int:
        raise BagError("out/flight: no such recording")

    install(fail)
    assert command.main(["bench"]) == 2
    assert capsys.readouterr().err == "uav-vslam: out/flight: no such recording\n"


def test_a_lack_of_memory_is_one_line_and_exit_code_1(install: Install, capsys: pytest.CaptureFixture[str]) -> None:
    install(lambda _: len(np.empty((1 << 30, 1 << 20))))  # 8 PiB
    assert command.main(["bench"]) == 1
    error = capsys.readouterr().err
    assert error.startswith("uav-vslam: not enough memory (Unable to allocate 8.00 PiB")
    assert "--cell" not in error  # that is a map's
    assert error.count("\n") == 1


def test_an_interrupt_is_exit_code_130(install: Install) -> None:
    def interrupt(_: argparse.Namespace) -> int:
        raise KeyboardInterrupt

    install(interrupt)
    assert command.main(["bench"]) == 130


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_that_a_library_swallows_gives_its_exit_code(
    install: Install, handlers: Handlers, number: int
) -> None:
    """As one does that takes any failure of an optional import for its absence, and stumbles over that later."""
    assert signal.getsignal(number) == handlers[number]

    def swallow(_: argparse.Namespace) -> int:
        with contextlib.suppress(BaseException):
            os.kill(os.getpid(), number)
        raise TypeError("unsupported operand")

    install(swallow)
    assert command.main(["bench"]) == 128 + number
    assert signal.getsignal(number) == signal.SIG_IGN  # a second one lets the process end


def test_handlers_of_signals_are_as_before_without_one(install: Install, handlers: Handlers) -> None:
    install(lambda _: 0)
    assert command.main(["bench"]) == 0
    assert {number: signal.getsignal(number) for number in handlers} == handlers


WRITER = """
import sys, time, types
from pathlib import Path
from uav_vslam.cli import main as command
from uav_vslam.evaluation.output import new_folder

def write(_):
    with new_folder(Path(sys.argv[1]), "slow"):
        print("writing", flush=True)
        time.sleep(600.0)

module = types.ModuleType("uav_vslam.cli.bench")
module.HELP, module.add_arguments, module.run = "", lambda parser: None, write
sys.modules[module.__name__] = module
sys.exit(command.main(["bench"]))
"""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_what_is_half_done_is_called_incomplete_after_a_signal(tmp_path: Path, number: int) -> None:
    with subprocess.Popen([sys.executable, "-c", WRITER, str(tmp_path)], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "writing\n"
        for _ in range(2):  # as `timeout` does
            process.send_signal(number)
        assert process.wait(timeout=60) == 128 + number
    (left,) = tmp_path.iterdir()
    assert left.name.endswith("_slow.incomplete")


STARTER = """
import os, signal, sys

class Interrupt:
    def find_spec(self, name, *_):
        if name == "uav_vslam.cli.messages":
            os.kill(os.getpid(), signal.SIGINT)

sys.meta_path.insert(0, Interrupt())
from uav_vslam.cli.start import main
sys.exit(main())
"""


def test_an_interrupt_while_the_command_is_imported_is_exit_code_130() -> None:
    done = subprocess.run([sys.executable, "-c", STARTER], capture_output=True)
    assert (done.returncode, done.stdout, done.stderr) == (130, b"", b"")


def test_a_bug_keeps_its_traceback(install: Install) -> None:
    def stumble(_: argparse.Namespace) -> int:
        raise ZeroDivisionError

    install(stumble)
    with pytest.raises(ZeroDivisionError):
        command.main(["bench"])


def test_version(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as leaving:
        command.main(["--version"])
    assert leaving.value.code == 0
    assert capsys.readouterr().out == f"uav-vslam {uav_vslam.__version__}\n"


def test_help_lists_the_verbs_with_examples(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as leaving:
        command.main(["--help"])
    assert leaving.value.code == 0
    text = capsys.readouterr().out
    assert "examples:" in text
    for verb in ("simulate", "launch", "topic"):
        assert f"\n    {verb}" in text


@pytest.mark.parametrize(
    ("arguments", "usage"),
    [([], "usage: uav-vslam "), (["fly"], "usage: uav-vslam "), (["run", "x", "--sette"], "usage: uav-vslam run ")],
)
def test_no_verb_or_an_unknown_one_or_option_is_wrong_input(
    arguments: list[str], usage: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as leaving:
        command.main(arguments)
    assert leaving.value.code == 2
    assert usage in capsys.readouterr().err


@pytest.mark.parametrize(
    "arguments",
    [
        ["run", "flight", "--config", "kagaru", "--config", "mine.yaml"],
        ["check", "flight", "--config", "kagaru", "--config", "mine.yaml"],
        ["map", "flight", "--vehicles", "uav1", "--vehicles", "uav2"],
        ["study", "split", "flight", "--config", "kagaru", "--config", "kagaru"],
    ],
)
def test_an_option_that_would_replace_itself_is_refused(
    arguments: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as leaving:
        command.main(arguments)
    assert leaving.value.code == 2
    assert f"argument {arguments[-2]}: given twice" in capsys.readouterr().err


def test_an_option_that_collects_may_be_repeated() -> None:
    words = ["run", "flight", "--set", "backend.sigma_px=1", "--set", "backend.window=4"]
    assert len(command.build_parser(words).parse_args(words).set) == 2


def test_help_imports_neither_numpy_nor_ros() -> None:
    program = (
        "import sys\nfrom uav_vslam.cli.main import build_parser\nbuild_parser([])\n"
        "print([m for m in ('numpy', 'cv2', 'scipy', 'rclpy') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


@pytest.mark.parametrize("verb", command.VERBS)
def test_every_verb_says_what_it_does(verb: str) -> None:
    module = pytest.importorskip(f"uav_vslam.cli.{command.module_name(verb)}", reason="verb not installed")
    assert module.HELP[0].islower()
    assert not module.HELP.endswith(".")
    parser = command.build_parser([verb])
    assert module.HELP in " ".join(parser.format_help().split())  # it may be wrapped


def test_a_missing_recording_is_told_before_anything_is_started(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    fleet = tmp_path / "fleet.yaml"
    fleet.write_text("vehicles: {uav1: {}}\nreplay: {bags: [nowhere]}\n")
    assert command.main(["launch", str(fleet)]) == 2
    error = capsys.readouterr().err
    assert "nowhere" in error
    assert error.count("\n") == 1


@pytest.mark.parametrize("domain", ["-1", "102"])
def test_a_domain_that_dds_can_not_use_is_refused(
    tmp_path: Path, domain: str, capsys: pytest.CaptureFixture[str]
) -> None:
    fleet = tmp_path / "fleet.yaml"
    fleet.write_text("vehicles: {uav1: {}}\n")
    assert command.main(["launch", str(fleet), f"--domain={domain}"]) == 2
    assert "use 0 to 101" in capsys.readouterr().err
