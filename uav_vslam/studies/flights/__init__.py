# SPDX-License-Identifier: Apache-2.0
"""The whole chain over rendered images."""

from __future__ import annotations

import argparse

from uav_vslam.studies.engine.study import Findings, Progress, Study


def run(args: argparse.Namespace, seeds: list[int], progress: Progress) -> Findings:
    """Fly with both grades of inertial unit."""
    from uav_vslam.studies.engine.flights import run_study
    from uav_vslam.studies.flights.compute import methods

    return Findings(run_study(methods(args.frames), seeds, workers=args.workers, on_seed=progress(len(seeds))))


STUDY = Study(
    help="rendered images through the front end, with two grades of inertial unit",
    takes="an hour",
    examples="""examples:
  uav-vslam study flights --seeds 8        about a quarter of an hour
  uav-vslam study flights --seeds 1 --frames 60
""",
    run=run,
    frames=160,
)
