# SPDX-License-Identifier: Apache-2.0
"""Every method of data association."""

from __future__ import annotations

import argparse
from pathlib import Path

from uav_vslam.studies.engine.study import Findings, Progress, Study


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare methods and recording."""
    from uav_vslam.config import ASSOCIATIONS

    parser.add_argument("--methods", nargs="+", choices=ASSOCIATIONS, default=ASSOCIATIONS, help="which (default all)")
    parser.add_argument("--recording", type=Path, metavar="BAG_OR_MAV0_DIR", help="with true poses, as `study euroc`")
    parser.add_argument("--config", default="euroc", metavar="NAME", help="of the recording (default euroc)")


def run(args: argparse.Namespace, seeds: list[int], progress: Progress) -> Findings:
    """Associate on rendered flights, and on a recording where there is one."""
    from uav_vslam.studies.association import compute as study
    from uav_vslam.studies.association.image_matching import IMAGE_NOTES, image_rows
    from uav_vslam.studies.association.plot import draw_association
    from uav_vslam.studies.engine.pool import in_pool
    from uav_vslam.studies.engine.scores import FAILURE_RULE, breakdowns

    methods = tuple(args.methods)
    jobs = [study.Job(condition, seed, args.frames, methods) for condition in study.CONDITIONS for seed in seeds]
    associated, matched = [], []
    for in_map, in_images in in_pool(study.study_rendered, jobs, args.workers, progress(len(jobs))):
        associated += in_map
        matched += in_images
    if args.recording:
        associated += study.study_recording(args.recording, args.config, methods, progress)
    rows = study.map_rows(associated) + image_rows(matched)
    notes = study.NOTES | IMAGE_NOTES | {"Failures": FAILURE_RULE} | breakdowns([one.run for one in associated])
    return Findings(rows, notes, draw=draw_association)


STUDY = Study(
    help="rendered images: every associator and matcher, clear and faint images, and a recording (thesis, chapter 6)",
    takes="a quarter of an hour",
    examples="""examples:
  uav-vslam study association                                        3 seeds, clear and faint
  uav-vslam study association --recording V1_01_easy/mav0            and EuRoC's
  uav-vslam study association --seeds 1 --methods gated nn hgtm      a first look

A flight's images are rendered and their features extracted once for all associators. Each feature's truth is known.
""",
    run=run,
    add_arguments=add_arguments,
    seeds=3,
    frames=100,
)
