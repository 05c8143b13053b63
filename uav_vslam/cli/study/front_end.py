# SPDX-License-Identifier: Apache-2.0
"""`uav-vslam study front_end`: points that are followed, and points that are matched anew."""

from __future__ import annotations

import argparse

from uav_vslam.cli.study.common import (
    add_run_arguments,
    add_variant_argument,
    progress_bar,
    seeds_of,
    show,
    variants_of,
)

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
    add_variant_argument(parser, "frontend.method klt and sift")


def run(args: argparse.Namespace) -> int:
    """Run the study; print its table, write and draw it."""
    from uav_vslam.config import find_config, load_vehicle
    from uav_vslam.evaluation.output import write_study
    from uav_vslam.report.front_end_plot import draw_front_ends
    from uav_vslam.simulation.scenario import Scenario
    from uav_vslam.studies.front_end import NOTES, VARIANTS, methods, run_study

    variants = variants_of(args) or VARIANTS
    configs = {name: load_vehicle(find_config("kagaru"), overrides=keys) for name, keys in variants.items()}
    compared, seeds = methods(Scenario(frames=args.frames, scale=args.scale), configs), seeds_of(args)
    with progress_bar("study front_end", len(compared) * len(seeds)) as advance:
        rows = run_study(compared, seeds, workers=args.workers, on_flight=advance)
    return show(write_study("study_front_end", rows, seeds, args.results, notes=NOTES, plot=draw_front_ends))
