# SPDX-License-Identifier: Apache-2.0
"""The effect of each component of the estimator, alone and with a peer."""

from __future__ import annotations

import argparse

from uav_vslam.studies.engine.study import Findings, Progress, Study


def run(args: argparse.Namespace, seeds: list[int], progress: Progress) -> Findings:
    """Fly the default and each variation of it."""
    from uav_vslam.studies.engine.flight_rows import flight_rows, fly_all, nees_series
    from uav_vslam.studies.engine.nees_time_plot import draw_nees
    from uav_vslam.studies.models.compute import methods

    compared = methods(args.frames)
    outcomes = fly_all(compared, seeds, workers=args.workers, on_seed=progress(len(seeds)))
    return Findings(flight_rows(compared, outcomes), {}, nees_series(compared, outcomes), draw_nees)


STUDY = Study(
    help="landmark level: INS, S-SLAM, C-SLAM and the thesis's model",
    takes="minutes",
    examples="""examples:
  uav-vslam study models --seeds 20
""",
    run=run,
    frames=160,
)
