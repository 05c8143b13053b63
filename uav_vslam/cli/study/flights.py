# SPDX-License-Identifier: Apache-2.0
"""`uav-vslam study flights`: the whole chain over rendered images."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from uav_vslam.cli.progress import progress_bar
from uav_vslam.cli.study.common import add_run_arguments, publish, seeds_of

if TYPE_CHECKING:
    from uav_vslam.studies.engine.flights import Method

HELP = "rendered images through the front end, with two grades of inertial unit"
EXAMPLES = """examples:
  uav-vslam study flights --seeds 8        about a quarter of an hour
  uav-vslam study flights --seeds 1 --frames 60
"""
IMUS = ("adis16480", "consumer")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the study's arguments."""
    add_run_arguments(parser, seeds=20)
    parser.add_argument("--frames", type=int, default=160, help="frames of each vehicle (default 160)")


def run(args: argparse.Namespace) -> int:
    """Run the study; print its table and write study.json."""
    from uav_vslam.studies.engine.flights import run_study

    seeds = seeds_of(args)
    with progress_bar("study flights", len(seeds)) as advance:
        rows = run_study(methods(args.frames), seeds, workers=args.workers, on_seed=advance)
    return publish("flights", rows, seeds, args.results)


def methods(frames: int) -> list[Method]:
    """Rendered images through the front end, with both grades of inertial unit."""
    from uav_vslam.config import find_config, load_vehicle
    from uav_vslam.simulation.scenario import Scenario
    from uav_vslam.studies.engine.flights import Method

    config = load_vehicle(find_config("kagaru"))
    return [
        Method("ri15", f"rendered, {frames} frames, {imu}", Scenario(frames=frames, imu=imu), config, rendered=True)
        for imu in IMUS
    ]
