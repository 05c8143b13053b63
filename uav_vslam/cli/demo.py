# SPDX-License-Identifier: Apache-2.0
"""`uav-vslam demo`: replay two vehicles' sample recordings through the node graph and report."""

from __future__ import annotations

import argparse
import re
import signal
import tempfile
import time
from pathlib import Path

from uav_vslam.cli.arguments import MODES, add_rate, add_results
from uav_vslam.cli.messages import say

HELP = "replay two vehicles' sample recordings through the node graph and report"
EXAMPLES = """examples:
  uav-vslam demo
  uav-vslam demo --mode none               without cooperation
  uav-vslam demo --keep out/demo           keep the recorded estimates and each process's output

One process a node, over DDS on a ROS domain of its own; nothing is left running. Results go below results/.
"""
FLEET = "fleet_demo.yaml"
ESTIMATES = "demo"  # the recorded bag
SERIOUS = re.compile(r"\[(WARN|ERROR|FATAL)\]|Error|Traceback")
STAMPED = re.compile(r"^\[(\w+)\] \[[\d.]+\] \[[\w./]+\]: ")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    parser.add_argument("--mode", choices=MODES, help="how the vehicles communicate (default wideband)")
    add_rate(parser, "0")
    add_results(parser)
    parser.add_argument("--keep", type=Path, metavar="DIR", help="keep estimates and output in this new folder")
    parser.add_argument("--no-plots", action="store_true", help="write figures and trajectories only")
    parser.add_argument("--verbose", action="store_true", help="print all output of all processes")


def run(args: argparse.Namespace) -> int:
    """Launch, evaluate, print; return the exit code of the first process that failed, or 0."""
    from uav_vslam.errors import BagError

    if args.keep is not None:
        if (args.keep / ESTIMATES).exists():
            raise BagError(f"{args.keep / ESTIMATES} exists already; choose another folder for --keep")
        args.keep.mkdir(parents=True, exist_ok=True)
        return _run_in(args.keep, args)
    with tempfile.TemporaryDirectory(prefix="uav_vslam_demo_") as folder:
        return _run_in(Path(folder), args)


def _run_in(folder: Path, args: argparse.Namespace) -> int:
    from uav_vslam.cli.evaluate import evaluate
    from uav_vslam.cli.launch import launch, read_fleet
    from uav_vslam.config import find_config, parameter_file
    from uav_vslam.ros.domain import claimed_domain
    from uav_vslam.ros.supervisor import print_line

    fleet = read_fleet(find_config(FLEET), bags=None, rate=args.rate, mode=args.mode)
    estimates = folder / ESTIMATES
    on_line = print_line if args.verbose else print_progress
    started = time.monotonic()
    with claimed_domain() as domain_id:
        print(f"starting {', '.join(fleet.vehicles)} and their replay on ROS domain {domain_id}", flush=True)
        code = launch(fleet, record=estimates, log_dir=folder / "log", domain_id=domain_id, on_line=on_line)
    if code == 128 + signal.SIGINT:  # the user's wish, no failure
        return code
    if code != 0:
        hint = "; see --verbose" if args.keep is None else f"; each process's output is in {folder / 'log'}"
        say(f"the node graph failed (exit code {code}){hint}")
        return code
    return evaluate(
        [estimates, *fleet.replay.bags],
        name="demo",
        results=args.results,
        config=parameter_file({f"/{name}/**": config for name, config in fleet.vehicles.items()}),
        draws=not args.no_plots,
        wall_s=time.monotonic() - started,
    )


def print_progress(name: str, line: str) -> None:
    """Print the replay's output, and of other nodes only errors; the replay itself reports which nodes still wait."""
    if name == "replay" or (SERIOUS.search(line) and "waiting for" not in line):
        print(f"[{name}] {STAMPED.sub('', line)}", flush=True)
