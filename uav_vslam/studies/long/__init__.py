# SPDX-License-Identifier: Apache-2.0
"""Error, time and memory over a long flight."""

from __future__ import annotations

import argparse

from uav_vslam.studies.engine.study import Findings, Progress, Study


def run(args: argparse.Namespace, seeds: list[int], progress: Progress) -> Findings:
    """Fly with each retention policy."""
    from uav_vslam.studies.engine.own_only import run_trials
    from uav_vslam.studies.engine.scores import breakdowns
    from uav_vslam.studies.long.compute import NOTES, POLICIES, long_rows, long_series, long_trial
    from uav_vslam.studies.long.plot import draw_long

    trial = long_trial(args.variant or POLICIES, frames=args.frames)
    runs = run_trials([trial], seeds, workers=args.workers, on_job=progress(len(seeds)))
    return Findings(long_rows(runs), NOTES | breakdowns(runs), long_series(runs), draw_long)


STUDY = Study(
    help="landmark level: 2.8 km over known ground, with each retention policy: error, time of a frame, memory",
    takes="minutes",
    examples="""examples:
  uav-vslam study long                                  5 seeds, each policy
  uav-vslam study long --variant backend.retention_cell_m=15 --variant backend.retention_cell_m=40
  uav-vslam study long --seeds 1 --variant backend.retention=none,backend.max_in_view=60
""",
    run=run,
    seeds=5,
    frames=1000,
    variants="each backend.retention",
)
