# SPDX-License-Identifier: Apache-2.0
"""Two vehicles' node graphs in real time on this machine."""

from __future__ import annotations

import argparse

from uav_vslam.argument_types import positive_number
from uav_vslam.studies.engine.study import Findings, Progress, Study


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the rate and the communication mode."""
    from uav_vslam.config.fusion import MODE_BUDGETS

    parser.add_argument("--rate", type=positive_number, default=1.0, help="multiple of real time (default 1)")
    parser.add_argument(
        "--mode",
        choices=tuple(MODE_BUDGETS),
        default="wideband",
        help="how the vehicles communicate (default wideband)",
    )


def run(args: argparse.Namespace, seeds: list[int], progress: Progress) -> Findings:
    """Fly each seed in real time."""
    from uav_vslam.config import find_config, load_vehicle
    from uav_vslam.studies.live.compute import NOTES
    from uav_vslam.studies.live.flights import fly

    config, advance = load_vehicle(find_config("kagaru"), overrides=args.set), progress(len(seeds))
    rows = []
    for seed in seeds:
        rows += fly(seed, config, frames=args.frames, scale=args.scale, rate=args.rate, mode=args.mode)
        advance()
    return Findings(rows, NOTES)


STUDY = Study(
    help="rendered images through the node graph in real time: frames processed, and each process's share of a core",
    takes="a minute",
    examples="""examples:
  uav-vslam study live                                       two vehicles, 160 frames of 1280x960 at 7.14 Hz
  uav-vslam study live --rate 0.5                            half as fast
  uav-vslam study live --set frontend.method=sift            another front end

The recording takes 2.5 MB a frame and vehicle in the temporary folder.
""",
    run=run,
    add_arguments=add_arguments,
    seeds=1,
    workers=0,
    frames=160,
    scaled=True,
    settings=True,
)
