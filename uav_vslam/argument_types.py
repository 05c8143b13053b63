# SPDX-License-Identifier: Apache-2.0
"""Argument types of the command line: texts become numbers, and what is out of bounds is refused.

Imported by `--help`, so nothing heavy here.
"""

import argparse
import dataclasses
import sys
from collections.abc import Callable

MOST_OFFSET_S = 1e9  # between two clocks, one of which may count from its own start
MOST_WAIT_S = 1e6  # 11 days; neither a sleep nor nanoseconds hold any number


def whole_number(least: int, wanted: str = "") -> Callable[[str], int]:
    """Return the type of a whole number of at least so much; `wanted` says it in other words."""

    def number(text: str) -> int:
        try:
            value = int(text)
        except ValueError:
            value = least - 1
        if value < least:
            raise argparse.ArgumentTypeError(f"{text!r} is not {wanted or f'a whole number of at least {least}'}")
        return value

    return number


def number_above_zero(wanted: str, most: float = sys.float_info.max) -> Callable[[str], float]:
    """Return the type of a finite number above zero, up to `most`; `wanted` says what it is."""

    def number(text: str) -> float:
        value = _number(text)
        if not 0.0 < value <= most:
            raise argparse.ArgumentTypeError(f"{text!r} is not {wanted}")
        return value

    return number


positive = whole_number(1, "a count of at least 1")
non_negative = whole_number(0)
positive_seconds = number_above_zero(f"a time in seconds above 0, of at most {MOST_WAIT_S:g}", most=MOST_WAIT_S)
length_m = number_above_zero("a length in metres above 0")


def lengths_m(text: str) -> tuple[float, ...]:
    """Return lengths above zero [m], separated by commas."""
    return tuple(map(length_m, text.split(",")))


def clock_offset_s(text: str) -> float:
    """Return a difference of two clocks [s], of either sign."""
    offset = _number(text)
    if not abs(offset) <= MOST_OFFSET_S:
        raise argparse.ArgumentTypeError(f"{text!r} is not a time in seconds, of at most {MOST_OFFSET_S:g}")
    return offset


def positive_number(text: str) -> float:
    """Return a number above zero, of a size whose square neither vanishes nor overflows."""
    from uav_vslam.config.settings import Setting

    try:
        return float(Setting("", above=0.0, kind=float).accepted(text))
    except ValueError as error:
        raise argparse.ArgumentTypeError(f"{text!r} is not {error}") from None


def length_of_map(name: str) -> Callable[[str], float]:
    """Return the type of a length above zero [m], as large as that setting of a map allows."""

    def number(text: str) -> float:
        from uav_vslam.config.nodes import MapConfig
        from uav_vslam.config.settings import own_settings

        try:
            return float(dataclasses.replace(own_settings(MapConfig)[name], at_least=None, above=0.0).accepted(text))
        except ValueError as error:
            raise argparse.ArgumentTypeError(f"{text!r} is not {error}") from None

    return number


def namespace(text: str) -> str:
    """Return a vehicle's name, which is its ROS namespace: letters, digits and underscores, and no digit first."""
    from uav_vslam.config.settings import is_vehicle_name

    if not is_vehicle_name(text):
        raise argparse.ArgumentTypeError(f"{text!r} is no ROS namespace: use letters, digits and _, and no digit first")
    return text


def _number(text: str) -> float:
    """Return a number; NaN, which fails every comparison, for any other text."""
    try:
        return float(text)
    except ValueError:
        return float("nan")
