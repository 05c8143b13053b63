# SPDX-License-Identifier: Apache-2.0
"""`uav-vslam evaluate`: score estimates against the truth, from recordings, trajectory files and results folders."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from uav_vslam.argument_types import clock_offset_s, lengths_m, positive_seconds
from uav_vslam.cli.arguments import add_results, first_given

if TYPE_CHECKING:
    from uav_vslam.evaluation.result import FlightResult

HELP = "score recordings, trajectory files and results folders against the truth"
EXAMPLES = """examples:
  uav-vslam evaluate mine.tum orbslam.txt --truth mav0/state_groundtruth_estimate0/data.csv
  uav-vslam evaluate results/latest results/2026-01-31_120000_v101       every vehicle and estimate, in one table
  uav-vslam evaluate 00.txt --truth poses/00.txt --times sequences/00/times.txt --alignment yaw
  uav-vslam evaluate out/estimates bags/sample                 estimates and truth in different bags

Files of TUM, KITTI and EuRoC are recognised by their content. Truth and estimate must be poses of the same body frame
(of the IMU, say). The table names what each ATE removes: nothing (unaligned), heading about the start (start yaw),
the start's position too (start pose), heading and position (yaw+pos), rotation and position (SE3). NEES needs the
covariance that results folders hold.

Files and results folders: comparison.json and comparison.png go into a new folder below results/, and results/latest
stays where it is. Bags: summary.json, trajectories and plots go into a new folder, to which results/latest leads. ATE
and end error need no alignment where the start state was given in the frame of the truth.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    parser.add_argument(
        "inputs", type=Path, nargs="+", metavar="FILE|RESULTS|BAG", help="trajectory files and results folders, or bags"
    )
    parser.add_argument(
        "--truth", type=Path, metavar="FILE", help="trajectory file of the truth (files, results folders)"
    )
    parser.add_argument("--times", type=Path, metavar="FILE", help="stamps [s] of KITTI files, one a line")
    parser.add_argument(
        "--segments", type=lengths_m, metavar="M,M,...", help="lengths for the drift (default: 100 to 800, or shares)"
    )
    parser.add_argument(
        "--max-gap", type=positive_seconds, metavar="S", help="of the truth, to interpolate (default 0.5)"
    )
    parser.add_argument(
        "--truth-offset",
        type=clock_offset_s,
        metavar="S",
        default=0.0,
        help="added to the stamps of the truth, where its clock was another (files, results folders)",
    )
    parser.add_argument("--name", help="of the results (default: name of the first bag, or comparison)")
    parser.add_argument(
        "--alignment",
        choices=["none", "start-yaw", "start-pose", "yaw", "se3"],
        default="none",
        help="of the estimates to the truth: in the plot of files and results folders, in all of a bag (default none)",
    )
    add_results(parser)
    parser.add_argument("--no-plots", action="store_true", help="write figures and trajectories only")


def run(args: argparse.Namespace) -> int:
    """Evaluate, write and print; return 2 if a recording is damaged, after evaluating what can be read."""
    from uav_vslam.cli.comparison import compare_files
    from uav_vslam.datasets.rosbag import is_bag
    from uav_vslam.errors import BagError, ConfigError, UavVslamError

    if missing := next((path for path in args.inputs if not path.exists()), None):
        raise UavVslamError(f"{missing} does not exist; give trajectory files, folders of results, or bags")
    bags = [path for path in args.inputs if is_bag(path)]
    if not bags:
        return compare_files(args)
    if len(bags) < len(args.inputs) or args.truth is not None:
        raise BagError(
            f"{bags[0]} is a bag, which is evaluated with other bags only; run it, and give the folder of the results"
        )
    useless = {
        "--times": args.times,
        "--segments": args.segments,
        "--max-gap": args.max_gap,
        "--truth-offset": args.truth_offset,
    }
    if given := first_given(useless):
        raise ConfigError(f"{given} serves files and results folders; evaluate {bags[0]} without, then its results")
    return evaluate(
        args.inputs,
        name=args.name or args.inputs[0].stem,
        results=args.results,
        config={"evaluated": [str(bag) for bag in args.inputs]},
        alignment=args.alignment,
        draws=not args.no_plots,
    )


def evaluate(
    bags: Sequence[Path],
    *,
    name: str,
    results: Path,
    config: dict[str, Any],
    alignment: str = "none",
    draws: bool = True,
    wall_s: float = 0.0,
) -> int:
    """Evaluate bags, write and print; return the exit status.

    Args:
        bags: recordings of estimates and of their inputs.
        name: of the results folder.
        results: folder of all results.
        config: how the estimates were made, for the results.
        alignment: of the estimates to the truth.
        draws: also draw plots and the page.
        wall_s: time that the run took [s]; 0 if it is not known.
    """
    from uav_vslam.cli.messages import say, warn_each, warn_of_truth
    from uav_vslam.cli.progress import progress_bar
    from uav_vslam.datasets.outputs import messages_to_read, read_outputs
    from uav_vslam.datasets.recorded_result import flight_result
    from uav_vslam.evaluation.output import write_results
    from uav_vslam.evaluation.summary import build_summary
    from uav_vslam.report.page.page import NAME as PAGE_NAME
    from uav_vslam.report.page.page import write_page
    from uav_vslam.report.plots import write_plots
    from uav_vslam.report.table import print_summary

    with progress_bar("reading", messages_to_read(bags)) as advance:
        outputs, damage = read_outputs(bags, on_message=advance)
    result = flight_result(name, outputs, config=config, wall_s=wall_s)

    def plot(result: FlightResult, folder: Path) -> list[Path]:
        return [*write_plots(result, folder), write_page([folder])]

    try:
        print_summary(build_summary(result, git=None, alignment=alignment))  # first: a full disk must not cost it
    finally:  # nor a reader that has closed the pipe the results
        folder = write_results(result, results, plot=plot if draws else None, alignment=alignment)
    print(f"written to {folder}")
    if draws:
        print(f"page: {folder / PAGE_NAME}")
    warn_each(f"{vehicle}: {text}" for vehicle, recorded in outputs.items() for text in recorded.warnings)
    warn_of_truth(result, {name: vehicle.truth for name, vehicle in result.vehicles.items()})
    if damage is not None:
        say(f"evaluated up to a break: {damage}")
    return 0 if damage is None else 2
