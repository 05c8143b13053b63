# SPDX-License-Identifier: Apache-2.0
"""`uav-vslam study outliers`: wrong matches."""

from __future__ import annotations

import argparse

from uav_vslam.cli.progress import progress_bar
from uav_vslam.cli.study.common import add_run_arguments, add_variants, publish, seeds_of, variants_of

HELP = "wrong matches at landmark level: far ones and look-alikes inside the gate, with and without robust updates"
EXAMPLES = """examples:
  uav-vslam study outliers                              20 seeds of two vehicles, each alone; about an hour
  uav-vslam study outliers --seeds 4 --variant backend.robust=true --variant backend.gate_probability=0.9
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the study's arguments."""
    add_run_arguments(parser, seeds=20)
    parser.add_argument("--vehicles", type=int, default=2, help="of each seed, each alone and a run (default 2)")
    parser.add_argument("--frames", type=int, default=160, help="frames of each vehicle (default 160)")
    add_variants(parser, "backend.robust=true and backend.robust=false")


def run(args: argparse.Namespace) -> int:
    """Run the study; print its table, write and draw it."""
    from uav_vslam.studies.engine.own_only import run_trials
    from uav_vslam.studies.engine.scores import breakdowns
    from uav_vslam.studies.outliers.compute import NOTES, ROBUST, outlier_rows, outlier_trials
    from uav_vslam.studies.outliers.plot import draw_outliers

    trials = outlier_trials(variants_of(args) or ROBUST, frames=args.frames, vehicles=args.vehicles)
    seeds = seeds_of(args)
    with progress_bar("study outliers", len(trials) * len(seeds)) as advance:
        runs = run_trials(trials, seeds, workers=args.workers, on_job=advance)
    rows = outlier_rows(runs)
    return publish("outliers", rows, seeds, args.results, notes=NOTES | breakdowns(runs), plot=draw_outliers)
