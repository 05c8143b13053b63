# SPDX-License-Identifier: Apache-2.0
"""`uav-vslam study faults`: cameras that fail."""

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
    add_variant_argument(parser, "frontend.method klt and sift")


def run(args: argparse.Namespace) -> int:
    """Run the study; print its table, write and draw it."""
    from uav_vslam.config import find_config, load_vehicle
    from uav_vslam.evaluation.output import write_study
    from uav_vslam.report.faults_plot import draw_faults
    from uav_vslam.simulation.scenario import Scenario
    from uav_vslam.studies.faults import NOTES, VARIANTS, jobs, run_study

    variants = variants_of(args) or VARIANTS
    configs = {name: load_vehicle(find_config("kagaru"), overrides=keys) for name, keys in variants.items()}
    seeds = seeds_of(args)
    work = jobs(Scenario(frames=args.frames, scale=args.scale, vehicles=1), configs, seeds)
    with progress_bar("study faults", len(work)) as advance:
        rows = run_study(work, workers=args.workers, on_flight=advance)
    return show(write_study("study_faults", rows, seeds, args.results, notes=NOTES, plot=draw_faults))
