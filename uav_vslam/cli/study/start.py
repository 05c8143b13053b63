# SPDX-License-Identifier: Apache-2.0
"""`uav-vslam study start`: flights without a start state, and with a wrong one."""

from __future__ import annotations

import argparse

from uav_vslam.cli.progress import progress_bar
from uav_vslam.cli.study.common import add_run_arguments, publish, seeds_of

HELP = "flights that begin without a start state or with a wrong one, at landmark level"
EXAMPLES = """examples:
  uav-vslam study start --seeds 20        minutes
"""
GRADES = ("adis16480", "consumer")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the study's arguments."""
    add_run_arguments(parser, seeds=20)
    parser.add_argument("--frames", type=int, default=160, help="frames of a flight without a start (default 160)")


def run(args: argparse.Namespace) -> int:
    """Run the study; print its tables and write study.json."""
    from uav_vslam.studies.start.compute import NOTES, WRONGS, study_rows

    seeds = seeds_of(args)
    with progress_bar("study start", (len(GRADES) + len(WRONGS)) * len(seeds)) as advance:
        rows = study_rows(GRADES, seeds, frames=args.frames, workers=args.workers, on_job=advance)
    return publish("start", rows, seeds, args.results, notes=NOTES)
