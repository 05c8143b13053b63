# SPDX-License-Identifier: Apache-2.0
"""`uav-vslam study frames`: two vehicles that don't know where each other's map lies."""

from __future__ import annotations

import argparse

from uav_vslam.cli.progress import progress_bar
from uav_vslam.cli.study.common import add_run_arguments, publish, seeds_of

HELP = "two vehicles whose map frames differ and whose landmarks are mistaken for one another, at landmark level"
EXAMPLES = """examples:
  uav-vslam study frames                   16 seeds; minutes
  uav-vslam study frames --seeds 2         a first look

It also tells what each stage of telling common landmarks is worth: ratio, mutual, gate, consistency.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the study's arguments."""
    add_run_arguments(parser, seeds=16)
    parser.add_argument("--frames", type=int, default=160, help="frames of each vehicle (default 160)")


def run(args: argparse.Namespace) -> int:
    """Run the study; print its tables and write study.json."""
    from uav_vslam.studies.frames.rows import NOTES, frame_rows

    seeds = seeds_of(args)
    with progress_bar("study frames", len(seeds)) as advance:
        rows = frame_rows(seeds, frames=args.frames, workers=args.workers, on_seed=advance)
    return publish("frames", rows, seeds, args.results, notes=NOTES)
