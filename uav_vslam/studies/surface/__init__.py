# SPDX-License-Identifier: Apache-2.0
"""The height of the ground and of what stands on it, against the truth of rendered flights."""

from __future__ import annotations

import argparse

from uav_vslam.argument_types import length_of_map, whole_number
from uav_vslam.studies.engine.study import Findings, Progress, Study


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what is flown."""
    parser.add_argument("--vehicles", type=whole_number(1), default=1, metavar="N", help="of each flight (default 1)")
    parser.add_argument("--bare", action="store_true", help="nothing stands on the ground")
    parser.add_argument(
        "--cell", type=length_of_map("cell_m"), default=0.5, metavar="M", help="side of a cell [m] (default 0.5)"
    )


def run(args: argparse.Namespace, seeds: list[int], progress: Progress) -> Findings:
    """Fly, smooth and map each seed; score the surfaces, and the poses they were made with."""
    from uav_vslam.studies.engine.pool import in_pool
    from uav_vslam.studies.surface.compute import NOTES, Job, map_seed
    from uav_vslam.studies.surface.rows import pose_rows, surface_rows

    jobs = [Job(seed, args.frames, args.vehicles, not args.bare, args.cell) for seed in seeds]
    found = list(in_pool(map_seed, jobs, args.workers, progress(len(jobs))))
    return Findings(surface_rows(found) + pose_rows(found), NOTES)


STUDY = Study(
    help="the surface by motion stereo, by the rig's own pair and by landmarks alone, against the true heights",
    takes="five minutes a seed",
    examples="""examples:
  uav-vslam study surface --seeds 5
  uav-vslam study surface --seeds 1 --frames 40 --bare
  uav-vslam study surface --seeds 5 --vehicles 2        one map of two vehicles, at the place of the fused poses
""",
    run=run,
    add_arguments=add_arguments,
    seeds=5,
    workers=1,
    frames=160,
)
