# SPDX-License-Identifier: Apache-2.0
"""`uav-vslam study euroc`: a recording with truth, by every filter from many starts."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from uav_vslam.cli.progress import progress_bar
from uav_vslam.cli.study.common import add_run_arguments, publish, seeds_of

if TYPE_CHECKING:
    from uav_vslam.config import VehicleConfig
    from uav_vslam.datasets.bag import BagFlight
    from uav_vslam.studies.euroc.starts import RecordedFlight

HELP = "a recording with truth, such as EuRoC's, by every filter from many starts"
EXAMPLES = """examples:
  uav-vslam study euroc V1_01_easy/mav0                    ASL folder: as recorded, 5 drawn and 3 later starts
  uav-vslam study euroc v101 --filters eif --seeds 20      a bag
  uav-vslam study euroc v101 --set backend.max_landmarks=300
"""
FILTERS = ("eif", "ekf", "ukf", "uhf")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the study's arguments."""
    parser.add_argument("recording", type=Path, metavar="BAG_OR_MAV0_DIR", help="bag, or folder with cam0, cam1, imu0")
    parser.add_argument("--config", default="euroc", metavar="NAME", help="YAML file or one in config/ (default euroc)")
    parser.add_argument("--filters", nargs="+", choices=FILTERS, default=FILTERS, help="which (default all)")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="override one setting")
    parser.add_argument("--vehicle", metavar="NAME", help="which of the bag (default the first)")
    add_run_arguments(parser, seeds=5)


def run(args: argparse.Namespace) -> int:
    """Run the study; print its tables, write and draw them."""
    from uav_vslam.cli.overrides import override
    from uav_vslam.config import find_config, load_vehicle
    from uav_vslam.studies.euroc.compute import NOTES, error_series, run_starts, table_rows
    from uav_vslam.studies.euroc.plot import draw_starts
    from uav_vslam.studies.euroc.starts import LATER_SHARES

    seeds = seeds_of(args)
    config = load_vehicle(find_config(args.config), overrides=dict(override(item) for item in args.set))
    flight = searched_recording(args.recording, args.vehicle, config)
    with progress_bar("flying", len(args.filters) * (1 + len(seeds) + len(LATER_SHARES))) as advance:
        runs = run_starts(flight, config, filters=args.filters, seeds=seeds, workers=args.workers, on_run=advance)
    rows, series = table_rows(flight, runs), error_series(flight, runs)
    return publish("euroc", rows, seeds, args.results, notes=NOTES, series=series, plot=draw_starts)


def searched_recording(recording: Path, vehicle: str | None, config: VehicleConfig) -> RecordedFlight:
    """Read a recording and search its images."""
    from uav_vslam.datasets.truth import truth_trajectory
    from uav_vslam.errors import BagError
    from uav_vslam.studies.euroc.starts import searched

    with _opened(recording, vehicle) as flight:
        track, truth = flight.truth(), truth_trajectory(flight)
        if track is None or truth is None:
            raise BagError(
                f"{recording} holds no {flight.vehicle}/ground_truth/odometry, which the study scores against"
            )
        with progress_bar("searching images", flight.frame_count) as advance:
            return searched(flight, config.frontend, truth=truth, velocities=track.velocities_world, on_frame=advance)


@contextmanager
def _opened(recording: Path, vehicle: str | None) -> Iterator[BagFlight]:
    """Open a bag; an ASL folder becomes one for the time being."""
    from tempfile import TemporaryDirectory

    from uav_vslam.datasets.bag import open_flight, vehicles
    from uav_vslam.datasets.euroc import read_euroc
    from uav_vslam.datasets.flight_writer import write_flights
    from uav_vslam.errors import BagError

    with TemporaryDirectory() as scratch:
        bag = recording
        if (recording / "cam0").is_dir():
            bag = Path(scratch) / "bag"
            write_flights(bag, [read_euroc(recording)])
        names = [vehicle] if vehicle else vehicles([bag])
        if not names:
            raise BagError(f"bag {recording} holds no <vehicle>/left/image_raw; record or remap the images")
        yield open_flight(bag, names[0])
