# SPDX-License-Identifier: Apache-2.0
"""A recording with truth, by every filter from many starts."""

from __future__ import annotations

import argparse
from pathlib import Path

from uav_vslam.studies.engine.study import Findings, Progress, Study

FILTERS = ("eif", "ekf", "ukf", "uhf")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the recording and the filters."""
    parser.add_argument("recording", type=Path, metavar="BAG_OR_MAV0_DIR", help="bag, or folder with cam0, cam1, imu0")
    parser.add_argument(
        "--config", default="euroc", metavar="NAME", help="one YAML file, or one in config/ (default euroc)"
    )
    parser.add_argument("--filters", nargs="+", choices=FILTERS, default=FILTERS, help="which (default all)")
    parser.add_argument("--vehicle", metavar="NAME", help="which of the bag (default the first)")


def run(args: argparse.Namespace, seeds: list[int], progress: Progress) -> Findings:
    """Search the images once, then fly every filter from every start."""
    from uav_vslam.config import find_config, load_vehicle
    from uav_vslam.studies.engine.recorded_flights import extracted_recording
    from uav_vslam.studies.euroc.compute import NOTES, error_series, run_starts, table_rows
    from uav_vslam.studies.euroc.plot import draw_starts
    from uav_vslam.studies.euroc.starts import LATER_SHARES

    config = load_vehicle(find_config(args.config), overrides=args.set)
    flight = extracted_recording(args.recording, args.vehicle, config, progress)
    advance = progress(len(args.filters) * (1 + len(seeds) + len(LATER_SHARES)))
    runs = run_starts(flight, config, filters=args.filters, seeds=seeds, workers=args.workers, on_run=advance)
    return Findings(table_rows(flight, runs), NOTES, error_series(flight, runs), draw_starts)


STUDY = Study(
    help="a recording with truth, such as EuRoC's, by every filter from many starts",
    takes="an hour",
    examples="""examples:
  uav-vslam study euroc V1_01_easy/mav0                    ASL folder: as recorded, 5 drawn and 3 later starts
  uav-vslam study euroc v101 --filters eif --seeds 20      a bag
  uav-vslam study euroc v101 --set backend.max_landmarks=300
""",
    run=run,
    add_arguments=add_arguments,
    seeds=5,
    seedless=True,
    settings=True,
)
