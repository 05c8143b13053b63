# SPDX-License-Identifier: Apache-2.0
"""Argument types: invalid values are refused before any work starts."""

from __future__ import annotations

import argparse
import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from uav_vslam.evaluation.files.geodetic import Datum


MODES = ("wideband", "narrowband", "none")  # the names in config.fusion.MODE_BUDGETS
MOST_OFFSET_S = 1e9  # between two clocks, one of which may count from its own start


def first_given(options: Mapping[str, object]) -> str:
    """Return the name of the first option that was given, empty if none was: to refuse those without effect."""
    return next((name for name, value in options.items() if value), "")


def positive(text: str) -> int:
    """Return a count of at least one."""
    return _whole(text, 1, "a count of at least 1")


def non_negative(text: str) -> int:
    """Return a count, or a seed."""
    return _whole(text, 0, "a whole number of at least 0")


def positive_seconds(text: str) -> float:
    """Return a duration above zero [s]."""
    return _above_zero(text, "a time in seconds above 0")


def clock_offset_s(text: str) -> float:
    """Return a difference of two clocks [s], of either sign."""
    offset = _number(text)
    if not abs(offset) <= MOST_OFFSET_S:
        raise argparse.ArgumentTypeError(f"{text!r} is not a time in seconds, of at most {MOST_OFFSET_S:g}")
    return offset


def length_m(text: str) -> float:
    """Return a length above zero [m]."""
    return _above_zero(text, "a length in metres above 0")


def lengths_m(text: str) -> tuple[float, ...]:
    """Return lengths above zero [m], separated by commas."""
    return tuple(map(length_m, text.split(",")))


def positive_number(text: str) -> float:
    """Return a number above zero, of a size whose square neither vanishes nor overflows."""
    from uav_vslam.config.settings import Setting

    try:
        return float(Setting("", above=0.0, kind=float).accepted(text))
    except ValueError as error:
        raise argparse.ArgumentTypeError(f"{text!r} is not {error}") from None


def namespace(text: str) -> str:
    """Return a vehicle's name, which is its ROS namespace: letters, digits and underscores, and no digit first."""
    if not re.fullmatch(r"[A-Za-z_][A-Za-z0-9_]*", text):
        raise argparse.ArgumentTypeError(f"{text!r} is no ROS namespace: use letters, digits and _, and no digit first")
    return text


def add_results(parser: argparse.ArgumentParser) -> None:
    """Declare the folder of all results, which is created with the first of them."""
    parser.add_argument(
        "--results", type=_results_folder, default="results", help="where results go (default results/)"
    )


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


def _whole(text: str, least: int, wanted: str) -> int:
    try:
        number = int(text)
    except ValueError:
        number = least - 1
    if number < least:
        raise argparse.ArgumentTypeError(f"{text!r} is not {wanted}")
    return number


def _number(text: str) -> float:
    """Return a number; NaN, which fails every comparison, for any other text."""
    try:
        return float(text)
    except ValueError:
        return float("nan")


def _above_zero(text: str, wanted: str) -> float:
    number = _number(text)
    if not 0.0 < number < float("inf"):
        raise argparse.ArgumentTypeError(f"{text!r} is not {wanted}")
    return number
