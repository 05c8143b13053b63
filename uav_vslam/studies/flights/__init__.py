# SPDX-License-Identifier: Apache-2.0
"""The whole chain over rendered images."""

from __future__ import annotations

import argparse

from uav_vslam.argument_types import whole_number
from uav_vslam.studies.engine.study import Findings, Progress, Study

GRADES = ("adis16480", "consumer")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what is flown."""
    parser.add_argument("--vehicles", type=whole_number(1), default=2, metavar="N", help="of each flight (default 2)")
    parser.add_argument("--pattern", default="leg", metavar="NAME", help="of the flight path (default leg)")
    parser.add_argument("--rate", type=float, default=7.14, metavar="HZ", help="of the images (default 7.14)")
    parser.add_argument("--contrast", type=float, default=1.0, metavar="C", help="of the ground in them (default 1)")
    parser.add_argument("--blur", type=float, default=1.0, metavar="PX", help="of them, by motion [px] (default 1)")
    text = f"classes of inertial unit (default {' '.join(GRADES)})"
    parser.add_argument("--no-smoothing", action="store_true", help="do not smooth each whole flight afterwards")
    parser.add_argument("--imu", nargs="+", default=list(GRADES), metavar="NAME", help=text)


def run(args: argparse.Namespace, seeds: list[int], progress: Progress) -> Findings:
    """Fly with each grade of inertial unit and each variant of the configuration."""
    from uav_vslam.studies.engine.flight_rows import flight_rows, fly_all, nees_series
    from uav_vslam.studies.engine.nees_time_plot import draw_nees
    from uav_vslam.studies.flights.compute import methods, notes, scenario_of

    scenario = scenario_of(args)
    compared = methods(scenario, args.imu, args.variant, smoothing=not args.no_smoothing)
    outcomes = fly_all(compared, seeds, workers=args.workers, on_seed=progress(len(seeds)))
    return Findings(flight_rows(compared, outcomes), notes(scenario), nees_series(compared, outcomes), draw_nees)


STUDY = Study(
    help="rendered images through the front end, with two grades of inertial unit: errors, NEES over time, cost",
    takes="minutes",
    examples="""examples:
  uav-vslam study flights --seeds 8
  uav-vslam study flights --seeds 1 --frames 60
  uav-vslam study flights --seeds 6 --vehicles 1                    one vehicle on its own
  uav-vslam study flights --seeds 3 --vehicles 1 --frames 300 --rate 20 --imu adis16480
  uav-vslam study flights --seeds 6 --vehicles 1 --contrast 0.2 --blur 4      faint images
  uav-vslam study flights --seeds 6 --vehicles 1 --variant backend.sigma_px=0.3 --variant backend.sigma_px=0.15

Times are per frame of one vehicle. Variants share the images, and the features where the front end is the same.
""",
    run=run,
    add_arguments=add_arguments,
    frames=160,
    variants="the configuration kagaru as it is",
)
