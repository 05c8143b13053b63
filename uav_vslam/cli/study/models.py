# SPDX-License-Identifier: Apache-2.0
"""`uav-vslam study models`: what each idea in the estimator is worth, alone and with a peer."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from uav_vslam.cli.progress import progress_bar
from uav_vslam.cli.study.common import add_run_arguments, publish, seeds_of

if TYPE_CHECKING:
    from uav_vslam.studies.engine.flights import Method

HELP = "INS, S-SLAM, C-SLAM and the thesis's model, at landmark level"
EXAMPLES = """examples:
  uav-vslam study models --seeds 20        minutes
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the study's arguments."""
    add_run_arguments(parser, seeds=20)
    parser.add_argument("--frames", type=int, default=160, help="frames of each vehicle (default 160)")


def run(args: argparse.Namespace) -> int:
    """Run the study; print its table and write study.json."""
    from uav_vslam.studies.engine.flights import run_study

    seeds = seeds_of(args)
    with progress_bar("study models", len(seeds)) as advance:
        rows = run_study(methods(args.frames), seeds, workers=args.workers, on_seed=advance)
    return publish("models", rows, seeds, args.results)


def methods(frames: int) -> list[Method]:
    """Landmark level, 1 px: the default, and what each idea in it is worth."""
    from uav_vslam.config import VehicleConfig
    from uav_vslam.simulation.scenario import Scenario
    from uav_vslam.studies.engine.flights import Method, with_backend

    scenario = Scenario(frames=frames)
    condition = f"landmarks, {frames} frames, 1 px, {scenario.imu}"
    default = VehicleConfig()
    return [
        Method("ri15", condition, scenario, default),
        Method("ri15, no depth smoothing", condition, scenario, with_backend(default, depth_sigma_ratio=0.0)),
        Method("so15", condition, scenario, with_backend(default, model="so15")),
        Method("euler9", condition, scenario, with_backend(default, model="euler9", depth_sigma_ratio=0.0)),
    ]
