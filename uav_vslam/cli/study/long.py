# SPDX-License-Identifier: Apache-2.0
"""`uav-vslam study long`: error, time and memory over a long flight."""

from __future__ import annotations

import argparse

from uav_vslam.cli.progress import progress_bar
from uav_vslam.cli.study.common import add_run_arguments, add_variants, publish, seeds_of, variants_of

HELP = "2.8 km over known ground, with each retention policy: error, time of a frame, memory"
EXAMPLES = """examples:
  uav-vslam study long                                  5 seeds, the four policies; minutes
  uav-vslam study long --variant backend.retention_cell_m=15 --variant backend.retention_cell_m=40
  uav-vslam study long --seeds 1 --variant backend.retention=none,backend.max_in_view=60
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the study's arguments."""
    add_run_arguments(parser, seeds=5)
    parser.add_argument("--frames", type=int, default=1000, help="of the flight (default 1000)")
    add_variants(parser, "each backend.retention")


def run(args: argparse.Namespace) -> int:
    """Run the study; print its table, write and draw it."""
    from uav_vslam.studies.engine.own_only import run_trials
    from uav_vslam.studies.engine.scores import breakdowns
    from uav_vslam.studies.long.compute import NOTES, POLICIES, long_rows, long_series, long_trial
    from uav_vslam.studies.long.plot import draw_long

    trial = long_trial(variants_of(args) or POLICIES, frames=args.frames)
    seeds = seeds_of(args)
    with progress_bar("study long", len(seeds)) as advance:
        runs = run_trials([trial], seeds, workers=args.workers, on_job=advance)
    rows, series = long_rows(runs), long_series(runs)
    return publish("long", rows, seeds, args.results, notes=NOTES | breakdowns(runs), series=series, plot=draw_long)
