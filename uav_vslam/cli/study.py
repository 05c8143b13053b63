# SPDX-License-Identifier: Apache-2.0
"""`uav-vslam study`: methods compared over many seeds."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from uav_vslam.studies.flights import Method

HELP = "compare methods over many simulated flights"
EXAMPLES = """examples:
  uav-vslam study fusion --seeds 20        landmark level: INS, S-SLAM, C-SLAM and the thesis's model; minutes
  uav-vslam study flights --seeds 8        rendered images, both inertial grades; about a quarter of an hour
  uav-vslam study flights --seeds 1 --frames 60
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    parser.add_argument("study", choices=["fusion", "flights"], help="which one")
    parser.add_argument("--seeds", type=int, default=20, metavar="N", help="seeds 1 to N (default 20)")
    parser.add_argument("--frames", type=int, default=160, help="frames of each vehicle (default 160)")
    parser.add_argument("--workers", type=int, default=2, help="processes (default 2)")
    parser.add_argument("--results", type=Path, default=Path("results"), help="where results go (default results/)")


def run(args: argparse.Namespace) -> int:
    """Run a study; print its table and write study.json."""
    from rich.progress import Progress

    from uav_vslam.evaluation.output import write_study
    from uav_vslam.studies.flights import run_study

    methods = _fusion(args.frames) if args.study == "fusion" else _flights(args.frames)
    seeds = list(range(1, args.seeds + 1))
    with Progress(transient=True) as progress:
        task = progress.add_task(f"study {args.study}", total=len(seeds))
        rows = run_study(methods, seeds, workers=args.workers, on_seed=lambda: progress.advance(task))
    folder = write_study(f"study_{args.study}", rows, seeds, args.results)
    print((folder / "study.md").read_text(encoding="utf-8"))
    print(f"results: {folder}")
    return 0


def _fusion(frames: int) -> list[Method]:
    """Landmark level, 1 px: the default, and what each idea in it is worth."""
    from uav_vslam.config import VehicleConfig
    from uav_vslam.simulation.scenario import Scenario
    from uav_vslam.studies.flights import Method, with_backend

    scenario = Scenario(frames=frames)
    condition = f"landmarks, {frames} frames, 1 px, {scenario.imu}"
    default = VehicleConfig()
    return [
        Method("ri15", condition, scenario, default),
        Method("ri15, no depth smoothing", condition, scenario, with_backend(default, depth_sigma_ratio=0.0)),
        Method("so15", condition, scenario, with_backend(default, model="so15")),
        Method("euler9", condition, scenario, with_backend(default, model="euler9", depth_sigma_ratio=0.0)),
    ]


def _flights(frames: int) -> list[Method]:
    """Rendered images through the front end, with both grades of inertial unit."""
    from uav_vslam.config import IMU_GRADES, find_config, load_vehicle
    from uav_vslam.simulation.scenario import Scenario
    from uav_vslam.studies.flights import Method

    config = load_vehicle(find_config("kagaru"))
    return [
        Method("ri15", f"rendered, {frames} frames, {imu}", Scenario(frames=frames, imu=imu), config, rendered=True)
        for imu in IMU_GRADES
    ]
