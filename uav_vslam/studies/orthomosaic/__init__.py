# SPDX-License-Identifier: Apache-2.0
"""Orthomosaics against the true picture of the ground."""

from __future__ import annotations

import argparse

from uav_vslam.argument_types import positive_number
from uav_vslam.studies.engine.study import Findings, Progress, Study


def run(args: argparse.Namespace, seeds: list[int], progress: Progress) -> Findings:
    """Fly two vehicles over each seed's ground, and make its picture by every method."""
    from uav_vslam.studies.engine.pool import in_pool
    from uav_vslam.studies.orthomosaic.compute import NOTES, Job, measured, mosaic_rows, mosaic_series
    from uav_vslam.studies.orthomosaic.plot import draw_orthomosaic

    jobs = [Job(seed, args.frames, args.m_per_px) for seed in seeds]
    found = [one for of_seed in in_pool(measured, jobs, args.workers, progress(len(jobs))) for one in of_seed]
    return Findings(mosaic_rows(found), NOTES, mosaic_series(found), draw_orthomosaic)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the resolution."""
    text = "side of a pixel of the picture [m] (default 0.1)"
    parser.add_argument("--m-per-px", type=positive_number, default=0.1, metavar="M", help=text)


STUDY = Study(
    help="orthomosaic over rendered ground against the true picture, a chain of homographies, and OpenCV's stitcher",
    takes="half an hour",
    examples="""examples:
  uav-vslam study orthomosaic                            5 seeds, 160 frames of two vehicles
  uav-vslam study orthomosaic --seeds 1 --frames 60

The surface is mapped by motion stereo from the same images and poses.
""",
    run=run,
    add_arguments=add_arguments,
    seeds=5,
    frames=160,
)
