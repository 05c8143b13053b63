# SPDX-License-Identifier: Apache-2.0
"""`uav-vslam study revisit`: loop closure over retained landmarks."""

from __future__ import annotations

import argparse

from uav_vslam.cli.progress import progress_bar
from uav_vslam.cli.study.common import add_run_arguments, add_variants, publish, seeds_of, variants_of

HELP = "flights that come back over their start after 2 km, with and without retained landmarks"
EXAMPLES = """examples:
  uav-vslam study revisit                               10 flights at landmark level, 3 rendered; about an hour
  uav-vslam study revisit --rendered-seeds 0            landmark level alone; minutes
  uav-vslam study revisit --rendered-seeds 0 --variant backend.min_revisited=1 --variant backend.min_revisited=3

A flight with nothing retained is always among them: it is what the others are compared with.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the study's arguments."""
    add_run_arguments(parser, seeds=10, workers=1)
    parser.add_argument(
        "--rendered-seeds", type=int, default=3, metavar="N", help="how many are rendered too (default 3)"
    )
    parser.add_argument("--frames", type=int, help="of each flight (default: round once, and 0.1 km on)")
    add_variants(parser, "the default settings")


def run(args: argparse.Namespace) -> int:
    """Run the study; print its table, write and draw it."""
    from uav_vslam.studies.engine.scores import breakdowns
    from uav_vslam.studies.revisit.compute import revisit_jobs, revisit_loops
    from uav_vslam.studies.revisit.plot import draw_revisit
    from uav_vslam.studies.revisit.rows import NOTES, revisit_rows, revisit_series

    seeds = seeds_of(args)
    rendered = list(range(args.first_seed, args.first_seed + args.rendered_seeds))
    jobs = revisit_jobs(variants_of(args), seeds, rendered, frames=args.frames)
    with progress_bar("study revisit", sum(job.scenario.frames for job in jobs)) as advance:
        loops = revisit_loops(jobs, workers=args.workers, on_frame=advance)
    rows, series, notes = revisit_rows(loops), revisit_series(loops), NOTES | breakdowns([loop.run for loop in loops])
    return publish("revisit", rows, seeds, args.results, notes=notes, series=series, plot=draw_revisit)
