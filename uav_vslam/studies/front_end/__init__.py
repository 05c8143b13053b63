# SPDX-License-Identifier: Apache-2.0
"""Tracked points, and points matched frame by frame."""

from __future__ import annotations

import argparse

from uav_vslam.studies.engine.study import Findings, Progress, Study


def run(args: argparse.Namespace, seeds: list[int], progress: Progress) -> Findings:
    """Measure each front end's points under every condition, and run SLAM on them."""
    from uav_vslam.simulation.scenario import Scenario
    from uav_vslam.studies.engine.flights import kagaru_configs
    from uav_vslam.studies.engine.variants import FRONT_ENDS
    from uav_vslam.studies.front_end.compute import NOTES, methods, run_study
    from uav_vslam.studies.front_end.plot import draw_front_ends

    compared = methods(Scenario(frames=args.frames, scale=args.scale), kagaru_configs(args.variant or FRONT_ENDS))
    rows = run_study(compared, seeds, workers=args.workers, on_flight=progress(len(compared) * len(seeds)))
    return Findings(rows, NOTES, draw=draw_front_ends)


STUDY = Study(
    help="rendered images: front ends' precision and cost, unequal cameras, and the resulting SLAM accuracy",
    takes="an hour",
    examples="""examples:
  uav-vslam study front_end --seeds 4                       two vehicles of 160 frames, 3 conditions
  uav-vslam study front_end --seeds 1 --frames 40           a quick check; minutes
  uav-vslam study front_end --seeds 1 --variant frontend.method=klt,frontend.search_scale=0.5
""",
    run=run,
    scaled=True,
    seeds=4,
    frames=160,
    variants="frontend.method klt and sift",
)
