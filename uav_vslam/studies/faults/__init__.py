# SPDX-License-Identifier: Apache-2.0
"""Cameras that fail."""

from __future__ import annotations

import argparse

from uav_vslam.studies.engine.study import Findings, Progress, Study


def run(args: argparse.Namespace, seeds: list[int], progress: Progress) -> Findings:
    """Fly each front end through every fault."""
    from uav_vslam.simulation.scenario import Scenario
    from uav_vslam.studies.engine.flights import kagaru_configs
    from uav_vslam.studies.engine.variants import FRONT_ENDS
    from uav_vslam.studies.faults.compute import NOTES, jobs, run_study
    from uav_vslam.studies.faults.plot import draw_faults

    scenario = Scenario(frames=args.frames, scale=args.scale, vehicles=1)
    work = jobs(scenario, kagaru_configs(args.variant or FRONT_ENDS), seeds)
    return Findings(run_study(work, workers=args.workers, on_flight=progress(len(work))), NOTES, draw=draw_faults)


STUDY = Study(
    help="rendered images: cameras that fail (lost, swapped, black, blurred, frozen images), and the diagnostics",
    takes="a quarter of an hour",
    examples="""examples:
  uav-vslam study faults                                    2 seeds, 7 faults and none, both front ends
  uav-vslam study faults --seeds 1 --variant frontend.method=klt
  uav-vslam study faults --seeds 1 --frames 60 --scale 0.375 --variant frontend.method=klt,frontend.search_scale=1.0
""",
    run=run,
    scaled=True,
    seeds=2,
    frames=160,
    variants="frontend.method klt and sift",
)
