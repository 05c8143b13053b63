# SPDX-License-Identifier: Apache-2.0
"""`uav-vslam study front_end`: points that are followed, and points that are matched anew."""

from __future__ import annotations

import argparse

from uav_vslam.cli.progress import progress_bar
from uav_vslam.cli.study.common import add_run_arguments, add_variants, configs_of, publish, seeds_of

HELP = "front ends over rendered flights: precision, cost, unequal cameras, and what SLAM makes of their points"
EXAMPLES = """examples:
  uav-vslam study front_end --seeds 4                       two vehicles of 160 frames, 3 conditions; an hour
  uav-vslam study front_end --seeds 1 --frames 40           a first look; minutes
  uav-vslam study front_end --seeds 1 --variant frontend.method=klt,frontend.search_scale=0.5
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the study's arguments."""
    add_run_arguments(parser, seeds=4)
    parser.add_argument("--frames", type=int, default=160, help="frames of each vehicle (default 160)")
    parser.add_argument("--scale", type=float, default=1.0, help="image size over 1280 x 960 (default 1)")
    add_variants(parser, "frontend.method klt and sift")


def run(args: argparse.Namespace) -> int:
    """Run the study; print its table, write and draw it."""
    from uav_vslam.simulation.scenario import Scenario
    from uav_vslam.studies.front_end.compute import NOTES, VARIANTS, methods, run_study
    from uav_vslam.studies.front_end.plot import draw_front_ends

    seeds = seeds_of(args)
    compared = methods(Scenario(frames=args.frames, scale=args.scale), configs_of(args, VARIANTS))
    with progress_bar("study front_end", len(compared) * len(seeds)) as advance:
        rows = run_study(compared, seeds, workers=args.workers, on_flight=advance)
    return publish("front_end", rows, seeds, args.results, notes=NOTES, plot=draw_front_ends)
