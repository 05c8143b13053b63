# SPDX-License-Identifier: Apache-2.0
"""The `uav-vslam` command: imports the verb's module, and turns its exceptions into one line and an exit code.

A verb is a module of this package with HELP, `add_arguments(parser)` and `run(args) -> int`. Only the requested one is
imported, and the verbs themselves import late, so that `--help` is quick.
"""

import argparse
import importlib
import io
import keyword
import os
import signal
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from types import FrameType, ModuleType
from typing import Any

from uav_vslam import __version__
from uav_vslam.cli.messages import DISK_FULL, say
from uav_vslam.errors import UavVslamError, WorkerEnded
from uav_vslam.memory import keep_freed_memory

VERBS = (
    "simulate",
    "import",
    "calibrate",
    "check",
    "cut",
    "run",
    "map",
    "mosaic",
    "launch",
    "evaluate",
    "report",
    "export",
    "demo",
    "study",
    "bench",
    "topic",
    "mode",
    "keys",
    "monitor",
)
EXAMPLES = """examples:
  uav-vslam demo                                     replay two vehicles' sample recordings and report
  uav-vslam launch config/fleet_demo.yaml            the same node graph, nothing evaluated
  uav-vslam run config/fleet_demo.yaml               the same stages in one process, without ROS
  uav-vslam simulate out/flight --frames 60          record a simulated flight of two vehicles
  uav-vslam VERB --help                              arguments and examples of one verb

Options are given once, but for those whose help says that they may be repeated.

exit codes: 0 done, 1 the run failed, 2 wrong input or configuration (the readable part of a damaged recording is used
first), 130 interrupted, 143 terminated, 141 the reader of the output closed the pipe
"""
MAPPING = ("map", "mosaic")
FAILURE, WRONG_INPUT, SIGNALLED, BROKEN_PIPE = 1, 2, 128, 141
USUAL = {signal.SIGINT: signal.default_int_handler, signal.SIGTERM: signal.SIG_DFL}  # handlers
CLEARING_UP_S = 1.0


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code."""
    keep_freed_memory()
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="replace")  # a terminal without a character still shows the rest of the table
    arguments = list(sys.argv[1:] if argv is None else argv)
    with _noting_signals() as noted:
        try:
            return _run(arguments)
        except KeyboardInterrupt:
            pass
        except Exception:
            if not noted:
                raise
    return SIGNALLED + (noted[-1] if noted else signal.SIGINT)


@contextmanager
def _noting_signals() -> Iterator[list[int]]:
    """Let SIGTERM interrupt as Ctrl-C does, so that what is half done is cleared up, and note both.

    Some libraries take an interrupt for a missing optional part while they are imported, and fail later. A second one
    that comes at once, as `timeout` sends it, interrupts neither the clearing up nor the end of the process.
    """
    noted: list[int] = []
    cleared_s = 0.0

    def interrupt(number: int, frame: FrameType | None) -> None:
        nonlocal cleared_s
        noted.append(number)
        if time.monotonic() >= cleared_s:
            cleared_s = time.monotonic() + CLEARING_UP_S
            raise KeyboardInterrupt

    taken = {number: usual for number, usual in USUAL.items() if signal.getsignal(number) == usual}
    for number in taken:  # ignored ones, as Ctrl-C in the background of a script, are left alone
        signal.signal(number, interrupt)
    try:
        yield noted
    finally:
        for number, usual in taken.items():
            signal.signal(number, signal.SIG_IGN if noted else usual)


def _run(arguments: list[str]) -> int:
    """Run a verb and return its exit code."""
    try:
        args, unknown = build_parser(arguments).parse_known_args(arguments)
        if unknown:  # argparse itself would show how to name a verb, not the verb's options
            args.parser.error(f"unrecognized arguments: {' '.join(unknown)}")
        return int(args.run(args))
    except UavVslamError as error:
        say(str(error))
        return FAILURE if isinstance(error, WorkerEnded) else WRONG_INPUT
    except BrokenPipeError:  # the reader closed the pipe; Python would raise again while it flushes at exit
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return BROKEN_PIPE
    except MemoryError as error:
        why = f" ({error})" if str(error) else ""
        remedy = "; a map takes less with larger --cell, --pixel" if arguments[0] in MAPPING else ""
        say(f"not enough memory{why}{remedy}")
        return FAILURE
    except OSError as error:
        if error.errno in DISK_FULL:
            where = f"{error.filename}: " if error.filename else ""
            say(f"{where}{error.strerror}; make room, or write to another disk")
            return FAILURE
        if error.filename is None:
            raise
        say(f"{error.filename}: {error.strerror}; check the path and its permissions")
        return WRONG_INPUT


class _Once(argparse.Action):
    """Store a value; argparse itself lets a second one replace the first without a word."""

    _parsed: argparse.Namespace | None = None

    def __call__(
        self,
        parser: argparse.ArgumentParser,
        namespace: argparse.Namespace,
        values: str | Sequence[object] | None,
        option_string: str | None = None,
    ) -> None:
        if self._parsed is namespace:
            raise argparse.ArgumentError(self, "given twice, and only one can count")
        self._parsed = namespace
        setattr(namespace, self.dest, values)


class _Parser(argparse.ArgumentParser):
    """Refuses options that are given twice, but for those that collect; subparsers are of the same class."""

    def __init__(self, *args: Any, **options: Any) -> None:
        super().__init__(*args, **options)
        self.register("action", None, _Once)


def build_parser(arguments: Sequence[str]) -> argparse.ArgumentParser:
    """Return the parser for the verb in `arguments`; it knows all verbs if there is none."""
    parser = _Parser(
        prog="uav-vslam",
        description="Cooperative stereo-inertial SLAM for several UAVs.",
        epilog=EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"uav-vslam {__version__}")
    chosen = [arguments[0]] if arguments and arguments[0] in VERBS else VERBS
    subparsers = parser.add_subparsers(title="verbs", metavar="VERB", required=True)
    for verb in chosen:
        _add_verb(subparsers, verb, importlib.import_module(f"uav_vslam.cli.{module_name(verb)}"))
    return parser


def module_name(verb: str) -> str:
    """Return the name of a verb's module; a keyword of Python, which no module can be called, gets an underscore."""
    return f"{verb}_" if keyword.iskeyword(verb) else verb


def _add_verb(subparsers: "argparse._SubParsersAction[_Parser]", verb: str, module: ModuleType) -> None:
    summary = str(module.HELP)
    description = summary[:1].upper() + summary[1:].rstrip(".") + "."
    subparser = subparsers.add_parser(verb, help=summary, description=description)
    subparser.formatter_class = argparse.RawDescriptionHelpFormatter
    subparser.epilog = getattr(module, "EXAMPLES", None)
    module.add_arguments(subparser)
    subparser.set_defaults(run=module.run, parser=subparser)


if __name__ == "__main__":
    sys.exit(main())
