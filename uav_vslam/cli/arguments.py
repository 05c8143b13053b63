# SPDX-License-Identifier: Apache-2.0
"""Options that several commands share; invalid values are refused before any work starts."""

from __future__ import annotations

import argparse
import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from uav_vslam.evaluation.files.geodetic import Datum


RESULTS = "results"  # the folder below the current one
MODES = ("wideband", "narrowband", "none")  # the names in config.fusion.MODE_BUDGETS


def first_given(options: Mapping[str, object]) -> str:
    """Return the name of the first option that was given, empty if none was: to refuse those without effect."""
    return next((name for name, value in options.items() if value), "")


def add_storage(parser: argparse.ArgumentParser) -> None:
    """Declare how a bag is stored."""
    parser.add_argument("--storage", default="mcap", choices=["mcap", "sqlite3"], help="bag format (default mcap)")
    parser.add_argument("--zstd", action="store_true", help="compress the mcap file's chunks")


def check_storage(args: argparse.Namespace) -> None:
    """Refuse what the storage does not have.

    Raises:
        ConfigError: sqlite3 is to be compressed.
    """
    from uav_vslam.errors import ConfigError

    if args.zstd and args.storage != "mcap":
        raise ConfigError(f"--zstd compresses mcap files; leave it out, or --storage {args.storage}")


def add_results(parser: argparse.ArgumentParser) -> None:
    """Declare the folder of all results, which is created with the first of them."""
    parser.add_argument("--results", type=_results_folder, default=RESULTS, help="where results go (default results/)")


def _results_folder(text: str) -> Path:
    from uav_vslam.datasets.unfinished import require_place
    from uav_vslam.errors import UavVslamError
    from uav_vslam.evaluation.output import latest_link

    folder = Path(text)
    try:
        require_place(folder)
        latest_link(folder)
    except UavVslamError as error:
        raise argparse.ArgumentTypeError(str(error)) from None
    return folder


def add_domain(parser: argparse.ArgumentParser, default: Any = None) -> None:
    """Declare on which ROS domain the graph is."""
    text = "ROS domain, 0 to 101 (default: ROS_DOMAIN_ID)"
    parser.add_argument("--domain", type=int, default=default, metavar="ID", help=text)


def add_rate(parser: argparse.ArgumentParser, default: str) -> None:
    """Declare how fast recordings are replayed; `default` in words."""
    text = f"multiple of real time; 0: paced by the graph, in lock-step (default: {default})"
    parser.add_argument("--rate", type=float, metavar="R", help=text)


def output_file(text: str) -> Path:
    """Return a file that can be written: an absent one in a folder that is there, or one that may be replaced."""
    path = Path(text)
    if path.is_dir() or not os.access(path if path.exists() else path.parent, os.W_OK):
        raise argparse.ArgumentTypeError(f"{path} can't be written; name a file in a folder that is there and writable")
    return path


def add_datum(parser: argparse.ArgumentParser, purpose: str) -> None:
    """Declare the options of where a map's origin is."""
    text = f"of the map's origin [deg, deg, m] ({purpose})"
    parser.add_argument("--datum", nargs="+", metavar=("LAT", "LON ALT"), help=text)
    parser.add_argument(
        "--yaw", type=float, metavar="DEG", help=f"of the map's x axis from east ({purpose}; default 0)"
    )


def datum_of(args: argparse.Namespace) -> Datum:
    """Return the datum given; it may be written with commas, but argparse takes -28.2,153.0,20 for an option.

    Raises:
        ConfigError: it is no datum.
    """
    from uav_vslam.errors import ConfigError
    from uav_vslam.evaluation.files.geodetic import Datum

    numbers = " ".join(args.datum).replace(",", " ").split()
    try:
        latitude_deg, longitude_deg, altitude_m = map(float, numbers)
    except ValueError:
        raise ConfigError(f"--datum {' '.join(args.datum)} is not LAT LON ALT in degrees and metres") from None
    return Datum(latitude_deg, longitude_deg, altitude_m, args.yaw or 0.0)
