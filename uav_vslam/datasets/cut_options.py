# SPDX-License-Identifier: Apache-2.0
"""How a recording is to be cut, as the command line says it; imported by `--help`, so nothing heavy here."""

import argparse
from dataclasses import dataclass

from uav_vslam.argument_types import number_above_zero, whole_number
from uav_vslam.errors import UavVslamError

VEHICLES = 2
MIN_OVERLAP = 0.25
# A landmark that one vehicle shows now is soon out of the other's view, and its map is thinned out there.
WITHIN_S = 10.0
LONGEST_S = 1e6  # any recording is shorter
FORM = "legs must look like 0-60,75-130: start and end in seconds since the first image, two or more"
BY_HAND = ("vehicles", "duration", "overlap")  # what legs by hand leave nothing to say about


@dataclass(frozen=True, slots=True)
class CutOptions:
    """What is asked for.

    Attributes:
        vehicles: how many legs.
        legs_s: start and end of each since the first image [s]; None if they are to be found.
        duration_s: of each leg [s]; None for the longest that overlap enough.
        min_overlap: least mean overlap of legs without a given duration.
        within_s: largest time between two vehicles' views of a place that counts as overlap [s].
    """

    vehicles: int = VEHICLES
    legs_s: tuple[tuple[float, float], ...] | None = None
    duration_s: float | None = None
    min_overlap: float = MIN_OVERLAP
    within_s: float = WITHIN_S


def add_cut_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments that `cut_options` reads."""
    duration_s = number_above_zero(f"a number of seconds above 0, at most {LONGEST_S:g}", LONGEST_S)
    parser.add_argument(
        "--vehicles",
        type=whole_number(2, "a number of vehicles, 2 or more"),
        metavar="N",
        help=f"how many (default {VEHICLES})",
    )
    parser.add_argument("--legs", type=_spans, metavar="T0-T1,T2-T3", help="by hand [s since the first image]")
    parser.add_argument("--duration", type=duration_s, metavar="S", help="of each leg (default: see below)")
    parser.add_argument(
        "--overlap",
        type=number_above_zero("a share above 0, at most 1", 1.0),
        metavar="SHARE",
        help=f"least overlap of legs without --duration, 0 to 1 (default {MIN_OVERLAP})",
    )
    parser.add_argument(
        "--within",
        type=duration_s,
        default=WITHIN_S,
        metavar="S",
        help=f"vehicles pass a place at most so long after each other (default {WITHIN_S:g})",
    )
    parser.add_argument("--vehicle", metavar="NAME", help="which of the recording (default the first)")


def cut_options(args: argparse.Namespace) -> CutOptions:
    """Return what the arguments ask for.

    Raises:
        UavVslamError: one of them leaves another without effect.
    """
    if not args.legs:
        return CutOptions(args.vehicles or VEHICLES, None, args.duration, args.overlap or MIN_OVERLAP, args.within)
    idle = [f"--{name}" for name in BY_HAND if getattr(args, name) is not None]
    if idle:
        raise UavVslamError(f"--legs says which legs there are: leave out {', '.join(idle)}, or --legs")
    return CutOptions(len(args.legs), args.legs, within_s=args.within)


def _spans(text: str) -> tuple[tuple[float, float], ...]:
    parts = [part.split("-") for part in text.split(",")]
    try:
        spans = tuple((float(start), float(end)) for start, end in parts)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r}: {FORM}") from None
    if len(spans) < 2 or not all(0.0 <= second <= LONGEST_S for span in spans for second in span):
        raise argparse.ArgumentTypeError(f"{text!r}: {FORM}")
    return spans
