# SPDX-License-Identifier: Apache-2.0
"""`uav-vslam evaluate`: score recorded estimates against the recorded truth."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from uav_vslam.cli.arguments import results_folder

if TYPE_CHECKING:
    from uav_vslam.datasets.outputs import RecordedOutputs
    from uav_vslam.evaluation.result import FlightResult, LinkCounters, VehicleResult

HELP = "score recorded estimates against the recorded truth"
EXAMPLES = """examples:
  uav-vslam evaluate out/estimates bags/sample                 estimates and truth lie in different bags
  uav-vslam evaluate out/estimates --alignment yaw             forgive yaw and position of the start
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
    """Evaluate as `run` does; one who made the recordings adds their configuration and how long that took [s]."""
    from uav_vslam.datasets.outputs import read_outputs
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


def flight_result(
    name: str, outputs: dict[str, RecordedOutputs], *, config: dict[str, Any], wall_s: float
) -> FlightResult:
    """Return recorded outputs as a flight."""
    from uav_vslam.evaluation.result import FlightResult

    vehicles = {vehicle: _vehicle_result(vehicle, recorded, outputs) for vehicle, recorded in outputs.items()}
    stamps = [estimate.stamp_ns for recorded in outputs.values() for estimate in recorded.own_only]
    modes = {recorded.link.mode for recorded in outputs.values() if recorded.link is not None}
    return FlightResult(
        name=name,
        seed=None,
        mode=modes.pop() if len(modes) == 1 else "mixed" if modes else "none",
        duration_s=(max(stamps) - min(stamps)) * 1e-9 if stamps else 0.0,
        wall_s=wall_s,
        vehicles=vehicles,
        config=config,
    )


def _vehicle_result(name: str, recorded: RecordedOutputs, fleet: dict[str, RecordedOutputs]) -> VehicleResult:
    from uav_vslam.evaluation.result import VehicleResult
    from uav_vslam.evaluation.trajectory import Trajectory

    s_slam = Trajectory.from_estimates(recorded.own_only)
    return VehicleResult(
        name=name,
        truth=Trajectory.from_estimates(recorded.truth) if recorded.truth else None,
        ins=Trajectory.from_estimates(recorded.dead_reckoning),
        s_slam=s_slam,
        c_slam=Trajectory.from_estimates(recorded.fused) if _has_peer(recorded, fleet) else None,
        frames_in=recorded.frames_in,
        frames_processed=len(s_slam),
        link=_counters(recorded),
    )


def _has_peer(recorded: RecordedOutputs, fleet: dict[str, RecordedOutputs]) -> bool:
    """Tell whether the fused track means anything: without a peer it repeats the own-only one."""
    if not recorded.fused or recorded.link is None or recorded.link.mode == "none":
        return False
    return bool(recorded.link.peers) or len(fleet) > 1


def _counters(recorded: RecordedOutputs) -> LinkCounters:
    from uav_vslam.evaluation.result import LinkCounters

    link = recorded.link
    if link is None:
        return LinkCounters()
    return LinkCounters(
        sent_bytes_per_s=link.sent_bytes_per_s,
        packets_sent=link.packets_sent,
        packets_received=link.packets_received,
        packets_used=link.packets_used,
        dropped=link.dropped,
    )
