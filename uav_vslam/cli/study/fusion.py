# SPDX-License-Identifier: Apache-2.0
"""`uav-vslam study fusion`: what cooperation gains, and whether it stays consistent."""

from __future__ import annotations

import argparse

from uav_vslam.cli.progress import progress_bar
from uav_vslam.cli.study.common import add_run_arguments, publish, seeds_of

HELP = "ways to fuse, the thesis's among them; bad radios; fleets of 2, 4 and 8; at landmark level"
EXAMPLES = """examples:
  uav-vslam study fusion                                20 seeds of everything; over an hour
  uav-vslam study fusion --parts schemes --seeds 4      a first look; minutes
  uav-vslam study fusion --parts network fleets
"""
PARTS = ("schemes", "network", "fleets")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the study's arguments."""
    add_run_arguments(parser, seeds=20)
    parser.add_argument("--parts", nargs="+", choices=PARTS, default=PARTS, help="which (default all)")
    parser.add_argument("--frames", type=int, default=160, help="of the short flights (default 160)")


def run(args: argparse.Namespace) -> int:
    """Run the study; print its tables, write and draw them."""
    from uav_vslam.studies.fusion.compute import NOTES, PARTS, run_parts
    from uav_vslam.studies.fusion.plot import draw_fusion

    parts = [part for name in args.parts for part in PARTS[name](args.frames)]
    seeds = seeds_of(args)
    with progress_bar("study fusion", len(parts) * len(seeds)) as advance:
        rows = run_parts(parts, seeds, workers=args.workers, on_job=advance)
    return publish("fusion", rows, seeds, args.results, notes=NOTES, plot=draw_fusion)
