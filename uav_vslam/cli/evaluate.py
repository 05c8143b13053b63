# SPDX-License-Identifier: Apache-2.0
"""`uav-vslam evaluate`: score recorded estimates against the recorded truth."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

from uav_vslam.cli.arguments import results_folder

HELP = "score recorded estimates against the recorded truth"
EXAMPLES = """examples:
  uav-vslam evaluate out/estimates bags/sample                 estimates and truth in different bags
  uav-vslam evaluate out/estimates --alignment yaw             align yaw and position of the start
  uav-vslam evaluate out/estimates bags/sample --no-plots --root out/results

Writes summary.json, TUM trajectories and plots into a new folder below results/, to which results/latest leads, and
prints the table. ATE and end error need no alignment where the start state was given in the frame of the truth.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.epilog = EXAMPLES
    parser.add_argument(
        "bags", type=Path, nargs="+", metavar="BAG", help="recordings of the estimates and of the truth"
    )
    parser.add_argument("--name", help="of the flight (default: name of the first bag)")
    parser.add_argument(
        "--alignment",
        choices=["none", "se3", "yaw"],
        default="none",
        help="of the estimates to the truth (default none)",
    )
    parser.add_argument("--root", type=results_folder, default="results", help="where results go (default results/)")
    parser.add_argument("--no-plots", action="store_true", help="write figures and trajectories only")


def run(args: argparse.Namespace) -> int:
    """Evaluate, write and print; return 2 if a recording is damaged, after evaluating what can be read."""
    return evaluate(args)


def evaluate(args: argparse.Namespace, *, config: dict[str, Any] | None = None, wall_s: float = 0.0) -> int:
    """Evaluate as `run` does; the caller that made the recordings adds their configuration and its run time [s]."""
    from uav_vslam.datasets.outputs import read_outputs
    from uav_vslam.datasets.recorded_result import flight_result
    from uav_vslam.evaluation.output import write_results
    from uav_vslam.evaluation.summary import build_summary
    from uav_vslam.report.plots import write_plots
    from uav_vslam.report.table import print_summary

    outputs, damage = read_outputs(args.bags)
    config = config or {"evaluated": [str(bag) for bag in args.bags]}
    result = flight_result(args.name or args.bags[0].stem, outputs, config=config, wall_s=wall_s)
    plot = None if args.no_plots else write_plots
    folder = write_results(result, args.root, plot=plot, alignment=args.alignment)
    print_summary(build_summary(result, git=None, alignment=args.alignment))
    print(f"written to {folder}")
    if damage is not None:
        print(f"uav-vslam: evaluated up to a break: {damage}", file=sys.stderr)
    return 0 if damage is None else 2
