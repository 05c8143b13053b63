# SPDX-License-Identifier: Apache-2.0
"""Flights in the map of an earlier one: the start, and whether what depends on one map is ever counted twice."""

from __future__ import annotations

import argparse

from uav_vslam.argument_types import whole_number
from uav_vslam.studies.engine.study import Findings, Progress, Study


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the study's own arguments."""
    from uav_vslam.config import IMU_GRADES

    parser.add_argument("--imu", choices=tuple(IMU_GRADES), default="adis16480", help="grade (default adis16480)")
    parser.add_argument(
        "--rendered-seeds",
        type=whole_number(0),
        default=3,
        metavar="N",
        help="also over rendered ground (default 3; 0: none)",
    )
    parser.add_argument("--no-smoothing", action="store_true", help="the map is the filter's, not smoothed afterwards")


def run(args: argparse.Namespace, seeds: list[int], progress: Progress) -> Findings:
    """Map the ground with one vehicle, then fly two others over it."""
    from uav_vslam.studies.map_reuse.compute import NOTES, study_rows

    rendered = [seeds[0] + k for k in range(args.rendered_seeds)] if seeds else []
    advance = progress(len(seeds) + len(rendered))
    rows = study_rows(
        seeds,
        rendered,
        frames=args.frames,
        workers=args.workers,
        imu=args.imu,
        smoothing=not args.no_smoothing,
        on_job=advance,
    )
    return Findings(rows, NOTES)


STUDY = Study(
    help="landmark level, and rendered: start in the map of an earlier flight, alone and two vehicles in one map",
    takes="ten minutes",
    examples="""examples:
  uav-vslam study map_reuse --seeds 20 --first-seed 1001
  uav-vslam study map_reuse --seeds 2 --rendered-seeds 0      a quick check
  uav-vslam study map_reuse --seeds 8 --rendered-seeds 0 --imu consumer
""",
    run=run,
    add_arguments=add_arguments,
    frames=100,
)
