# SPDX-License-Identifier: Apache-2.0
"""Cost and gain of the packet modes, measured on the whole node graph over DDS."""

from __future__ import annotations

import argparse
import sys

from uav_vslam.studies.engine.study import Findings, Progress, Study


def run(args: argparse.Namespace, seeds: list[int], progress: Progress) -> Findings:
    """Fly each seed in both modes; where the graph fails, report it and continue."""
    from uav_vslam.studies.radio.compute import MODES, NOTES, radio_rows
    from uav_vslam.studies.radio.flights import fly_seed

    advance, runs = progress(len(seeds) * len(MODES)), []
    for seed in seeds:
        for mode, found in fly_seed(seed, args.frames, args.scale):
            if isinstance(found, Exception):
                print(f"uav-vslam: seed {seed}, {mode}: {found}", file=sys.stderr)
            else:
                runs += found
            advance()
    return Findings(radio_rows(runs, len(seeds)), NOTES)


STUDY = Study(
    help="rendered images through the node graph over DDS, wideband and narrowband: error, payload, packets",
    takes="an hour",
    examples="""examples:
  uav-vslam study radio                    5 flights of 160 frames, each in both modes
  uav-vslam study radio --seeds 1 --frames 30

One process a node, so run nothing else meanwhile; a flight's images take 170 MB for its duration.
""",
    scaled=True,
    run=run,
    seeds=5,
    workers=0,
    frames=160,
)
