# SPDX-License-Identifier: Apache-2.0
"""`uav-vslam study association`: every way to tell which feature is which."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from uav_vslam.cli.progress import progress_bar
from uav_vslam.cli.study.common import add_run_arguments, publish, seeds_of

if TYPE_CHECKING:
    from uav_vslam.studies.association.compute import Association

HELP = "every associator and matcher on rendered images, clear and faint ones, and on a recording (thesis, chapter 6)"
EXAMPLES = """examples:
  uav-vslam study association                                        3 seeds, clear and faint; a quarter of an hour
  uav-vslam study association --recording V1_01_easy/mav0            and EuRoC's
  uav-vslam study association --seeds 1 --methods gated nn hgtm      a first look

A flight's images are drawn and searched once for all associators. The truth says what each feature shows.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the study's arguments."""
    from uav_vslam.config import ASSOCIATIONS

    add_run_arguments(parser, seeds=3)
    parser.add_argument("--frames", type=int, default=100, help="frames of each flight (default 100)")
    parser.add_argument("--methods", nargs="+", choices=ASSOCIATIONS, default=ASSOCIATIONS, help="which (default all)")
    parser.add_argument("--recording", type=Path, metavar="BAG_OR_MAV0_DIR", help="with true poses, as `study euroc`")
    parser.add_argument("--config", default="euroc", metavar="NAME", help="of the recording (default euroc)")


def run(args: argparse.Namespace) -> int:
    """Run the study; print its tables, write and draw them."""
    from uav_vslam.studies.association.compute import CONDITIONS, NOTES, Job, map_rows, study_rendered
    from uav_vslam.studies.association.image_matching import IMAGE_NOTES, image_rows
    from uav_vslam.studies.association.plot import draw_association
    from uav_vslam.studies.engine.pool import in_pool
    from uav_vslam.studies.engine.scores import FAILURE_RULE, breakdowns

    seeds = seeds_of(args)
    jobs = [Job(condition, seed, args.frames, tuple(args.methods)) for condition in CONDITIONS for seed in seeds]
    associated, judged = [], []
    with progress_bar("study association", len(jobs)) as advance:
        for in_map, in_images in in_pool(study_rendered, jobs, args.workers):
            associated += in_map
            judged += in_images
            advance()
    associated.sort(key=lambda one: (list(CONDITIONS).index(one.run.condition), one.run.seed))
    judged.sort(key=lambda one: list(CONDITIONS).index(one.condition))
    if args.recording:
        associated += _recording(args)
    rows = map_rows(associated) + image_rows(judged)
    notes = NOTES | IMAGE_NOTES | {"Failures": FAILURE_RULE} | breakdowns([one.run for one in associated])
    return publish("association", rows, seeds, args.results, notes=notes, plot=draw_association)


def _recording(args: argparse.Namespace) -> list[Association]:
    from uav_vslam.cli.study.euroc import searched_recording
    from uav_vslam.config import find_config, load_vehicle
    from uav_vslam.studies.association.compute import associate_all
    from uav_vslam.studies.engine.searched_flights import recorded_flight

    config = load_vehicle(find_config(args.config))
    found = searched_recording(args.recording, None, config)
    return associate_all(recorded_flight(args.recording.parent.name or "recording", found, config), args.methods)
