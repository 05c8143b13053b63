# SPDX-License-Identifier: Apache-2.0
"""What every study's command line shares: its arguments, the progress bar, and saying where the results are."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path


def add_run_arguments(parser: argparse.ArgumentParser, *, seeds: int, workers: int = 2) -> None:
    """Declare seeds, processes and the results folder, with a study's own defaults."""
    parser.add_argument("--seeds", type=int, default=seeds, metavar="N", help=f"seeds 1 to N (default {seeds})")
    parser.add_argument("--workers", type=int, default=workers, help=f"processes (default {workers})")
    parser.add_argument("--results", type=Path, default=Path("results"), help="where results go (default results/)")


def seeds_of(args: argparse.Namespace) -> list[int]:
    """Return the seeds asked for."""
    return list(range(1, args.seeds + 1))


def add_variant_argument(parser: argparse.ArgumentParser, default: str) -> None:
    """Declare the settings to be compared."""
    parser.add_argument(
        "--variant",
        action="append",
        default=[],
        metavar="KEY=VALUE[,KEY=VALUE...]",
        help=f"a setting to compare, again for another (default: {default})",
    )


def variants_of(args: argparse.Namespace) -> dict[str, dict[str, object]]:
    """Return the settings to be compared by their text; none where the study's own are wanted."""
    from uav_vslam.cli.overrides import override

    return {text: dict(override(item) for item in text.split(",")) for text in args.variant}


@contextmanager
def progress_bar(title: str, total: int) -> Iterator[Callable[[], None]]:
    """Show a bar and give the function that moves it on by one."""
    from rich.progress import Progress

    with Progress(transient=True) as progress:
        task = progress.add_task(title, total=total)
        yield lambda: progress.advance(task)


def show(folder: Path) -> int:
    """Print the tables of a study that has been written, and where it is; return the exit code."""
    print((folder / "study.md").read_text(encoding="utf-8"))
    print(f"results: {folder}")
    return 0
