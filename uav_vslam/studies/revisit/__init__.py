# SPDX-License-Identifier: Apache-2.0
"""Loop closure over retained landmarks."""

from __future__ import annotations

import argparse

from uav_vslam.argument_types import whole_number
from uav_vslam.studies.engine.study import Findings, Progress, Study


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare how many flights are rendered, and how long they are."""
    parser.add_argument(
        "--rendered-seeds", type=whole_number(0), default=3, metavar="N", help="how many are rendered too (default 3)"
    )
    parser.add_argument("--frames", type=whole_number(2), help="of each flight (default: round once, and 0.1 km on)")


def run(args: argparse.Namespace, seeds: list[int], progress: Progress) -> Findings:
    """Fly all loops at landmark level, and some of them rendered."""
    from uav_vslam.studies.engine.scores import breakdowns
    from uav_vslam.studies.revisit.compute import revisit_jobs, revisit_loops
    from uav_vslam.studies.revisit.plot import draw_revisit
    from uav_vslam.studies.revisit.rows import NOTES, revisit_rows, revisit_series

    rendered = range(args.first_seed, args.first_seed + args.rendered_seeds)
    jobs = revisit_jobs(args.variant, seeds, rendered, frames=args.frames)
    advance = progress(sum(job.scenario.frames for job in jobs))
    loops = revisit_loops(jobs, workers=args.workers, on_frame=advance)
    notes = NOTES | breakdowns([loop.run for loop in loops])
    return Findings(revisit_rows(loops), notes, revisit_series(loops), draw_revisit)


STUDY = Study(
    help="landmark level and rendered: return to the start after 2 km, with and without retained landmarks",
    takes="an hour",
    examples="""examples:
  uav-vslam study revisit                               10 flights at landmark level, 3 rendered
  uav-vslam study revisit --rendered-seeds 0            landmark level alone; minutes
  uav-vslam study revisit --rendered-seeds 0 --variant backend.chance_revisits=10

A flight with nothing retained is always included, as the reference for the others.
""",
    run=run,
    add_arguments=add_arguments,
    seeds=10,
    workers=1,
    variants="the default settings",
)
