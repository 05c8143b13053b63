# SPDX-License-Identifier: Apache-2.0
"""`uav-vslam study faults`: cameras that fail."""

from __future__ import annotations

import argparse

from uav_vslam.cli.progress import progress_bar
from uav_vslam.cli.study.common import add_run_arguments, add_variants, configs_of, publish, seeds_of

HELP = "cameras that fail: lost, swapped, black, blurred, frozen images, and what the diagnostics say"
EXAMPLES = """examples:
  uav-vslam study faults                                    2 seeds, 7 faults and none, both front ends; an hour
  uav-vslam study faults --seeds 1 --variant frontend.method=klt
  uav-vslam study faults --seeds 1 --frames 60 --scale 0.375 --variant frontend.method=klt,frontend.search_scale=1.0
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the study's arguments."""
    add_run_arguments(parser, seeds=2)
    parser.add_argument("--frames", type=int, default=160, help="frames of each flight (default 160)")
    parser.add_argument("--scale", type=float, default=1.0, help="image size over 1280 x 960 (default 1)")
    add_variants(parser, "frontend.method klt and sift")


def run(args: argparse.Namespace) -> int:
    """Run the study; print its table, write and draw it."""
    from uav_vslam.simulation.scenario import Scenario
    from uav_vslam.studies.faults.compute import NOTES, VARIANTS, jobs, run_study
    from uav_vslam.studies.faults.plot import draw_faults

    seeds = seeds_of(args)
    work = jobs(Scenario(frames=args.frames, scale=args.scale, vehicles=1), configs_of(args, VARIANTS), seeds)
    with progress_bar("study faults", len(work)) as advance:
        rows = run_study(work, workers=args.workers, on_flight=advance)
    return publish("faults", rows, seeds, args.results, notes=NOTES, plot=draw_faults)
