# SPDX-License-Identifier: Apache-2.0
"""What every study's command line shares: its arguments, and how its results are published."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from uav_vslam.cli.arguments import non_negative, positive, results_folder

if TYPE_CHECKING:
    from uav_vslam.config import VehicleConfig
    from uav_vslam.evaluation.output import StudyPlotter
    from uav_vslam.evaluation.study import Row


def add_run_arguments(parser: argparse.ArgumentParser, *, seeds: int, workers: int = 2) -> None:
    """Declare seeds, processes and the results folder, with a study's own defaults."""
    add_seeds(parser, seeds)
    parser.add_argument("--workers", type=positive, default=workers, help=f"processes (default {workers})")
    parser.add_argument("--results", type=results_folder, default="results", help="where results go (default results/)")


def add_seeds(parser: argparse.ArgumentParser, default: int, help: str = "how many seeds") -> None:
    """Declare how many flights are drawn, and from which seed on."""
    parser.add_argument("--seeds", type=non_negative, default=default, metavar="N", help=f"{help} (default {default})")
    parser.add_argument("--first-seed", type=non_negative, default=1, metavar="K", help="the first of them (default 1)")


def seeds_of(args: argparse.Namespace) -> list[int]:
    """Return the seeds asked for."""
    return list(range(args.first_seed, args.first_seed + args.seeds))


def add_variants(parser: argparse.ArgumentParser, default: str) -> None:
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


def configs_of(args: argparse.Namespace, own: Mapping[str, dict[str, object]]) -> dict[str, VehicleConfig]:
    """Return the configuration of rendered flights with each of the settings to be compared, or the study's own."""
    from uav_vslam.config import find_config, load_vehicle

    variants = variants_of(args) or own
    return {name: load_vehicle(find_config("kagaru"), overrides=keys) for name, keys in variants.items()}


def publish(
    study: str,
    rows: list[Row],
    seeds: list[int],
    results: Path,
    *,
    notes: Mapping[str, str] | None = None,
    series: list[Row] | None = None,
    plot: StudyPlotter | None = None,
) -> int:
    """Write a study's tables and plots as `write_study` does, say so, and return the exit code."""
    from uav_vslam.evaluation.output import write_study

    folder = write_study(f"study_{study}", rows, seeds, results, notes=notes, series=series, plot=plot)
    print((folder / "study.md").read_text(encoding="utf-8"))
    print(f"results: {folder}")
    return 0
