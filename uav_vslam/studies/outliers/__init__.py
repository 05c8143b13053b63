# SPDX-License-Identifier: Apache-2.0
"""Wrong matches."""

from __future__ import annotations

import argparse

from uav_vslam.argument_types import whole_number
from uav_vslam.studies.engine.study import Findings, Progress, Study


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the number of vehicles."""
    parser.add_argument(
        "--vehicles", type=whole_number(1), default=2, help="of each seed, each alone and a run (default 2)"
    )


def run(args: argparse.Namespace, seeds: list[int], progress: Progress) -> Findings:
    """Fly with each kind and share of wrong matches."""
    from uav_vslam.studies.engine.own_only import run_trials
    from uav_vslam.studies.engine.scores import breakdowns
    from uav_vslam.studies.outliers.compute import NOTES, ROBUST, outlier_rows, outlier_trials
    from uav_vslam.studies.outliers.plot import draw_outliers

    trials = outlier_trials(args.variant or ROBUST, frames=args.frames, vehicles=args.vehicles)
    runs = run_trials(trials, seeds, workers=args.workers, on_job=progress(len(trials) * len(seeds)))
    return Findings(outlier_rows(runs), NOTES | breakdowns(runs), draw=draw_outliers)


STUDY = Study(
    help="landmark level: wrong matches, far ones and similar ones inside the gate, with and without robust updates",
    takes="an hour",
    examples="""examples:
  uav-vslam study outliers                              20 seeds of two vehicles, each alone
  uav-vslam study outliers --seeds 4 --variant backend.robust=true --variant backend.gate_probability=0.9
""",
    run=run,
    add_arguments=add_arguments,
    frames=160,
    variants="backend.robust=true and backend.robust=false",
)
