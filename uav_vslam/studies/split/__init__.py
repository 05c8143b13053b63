# SPDX-License-Identifier: Apache-2.0
"""One recorded flight as several vehicles, with and without communication (section 7.4 of [thesis])."""

from __future__ import annotations

import argparse
from pathlib import Path

from uav_vslam.datasets.cut_options import add_cut_arguments, cut_options
from uav_vslam.studies.engine.study import Findings, Progress, Study


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the recording and how it is cut."""
    parser.add_argument("bag", type=Path, metavar="BAG", help="recording of one vehicle with ground truth")
    parser.add_argument("--config", metavar="NAME", help="one YAML file, or name of one in config/, of the recording")
    add_cut_arguments(parser)


def run(args: argparse.Namespace, seeds: list[int], progress: Progress) -> Findings:
    """Cut, search the images once, then fly all legs from every drawn start in each communication mode."""
    from uav_vslam.config import find_config, load_vehicle
    from uav_vslam.datasets.cutting import plan_cut, poses_of, source_of
    from uav_vslam.datasets.sensor_setup import with_noise_of_files
    from uav_vslam.studies.split.compute import NOTES, run_starts, searched_legs
    from uav_vslam.studies.split.plot import draw_split
    from uav_vslam.studies.split.rows import error_rows, failure_note, leg_rows, series_of

    options = cut_options(args)
    file = find_config(args.config) if args.config else None
    config = with_noise_of_files(load_vehicle(file, overrides=args.set))
    flight = source_of(args.bag, args.vehicle, config.input)
    poses, velocities = poses_of(flight)
    advance = progress(flight.frame_count, "measuring overlap")
    cut = plan_cut(flight, poses, velocities, config, options, advance)
    advance = progress(sum(vehicle.frames for vehicle in cut.vehicles), "searching images")
    legs = searched_legs(flight, cut, poses, config, advance)
    outcomes = run_starts(legs, cut, config, seeds, workers=args.workers, on_run=progress(len(seeds), "flying"))
    rows = leg_rows(cut) + error_rows(legs, outcomes)
    return Findings(rows, NOTES | failure_note(outcomes), series_of(legs, outcomes), draw_split)


STUDY = Study(
    help="one recorded flight cut into overlapping legs: INS, S-SLAM, C-SLAM in wideband and narrowband",
    takes="a few minutes a recording",
    examples="""examples:
  uav-vslam study split flight --config kagaru          the two longest legs that overlap, as `uav-vslam cut` finds
  uav-vslam study split v101 --config euroc
  uav-vslam study split flight --legs 0-60,75-135 --set backend.association=hgtm
""",
    run=run,
    add_arguments=add_arguments,
    settings=True,
)
