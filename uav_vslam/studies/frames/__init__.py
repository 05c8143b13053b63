# SPDX-License-Identifier: Apache-2.0
"""Two vehicles with unknown transform between their maps."""

from __future__ import annotations

import argparse

from uav_vslam.studies.engine.study import Findings, Progress, Study


def run(args: argparse.Namespace, seeds: list[int], progress: Progress) -> Findings:
    """Fly with each share of mistaken landmarks."""
    from uav_vslam.studies.frames.rows import NOTES, frame_rows

    rows = frame_rows(seeds, frames=args.frames, workers=args.workers, on_seed=progress(len(seeds)))
    return Findings(rows, NOTES)


STUDY = Study(
    help="landmark level: two vehicles whose map frames differ and whose landmarks are mistaken for one another",
    takes="minutes",
    examples="""examples:
  uav-vslam study frames                   16 seeds
  uav-vslam study frames --seeds 2         a quick check

It also measures each stage of data association between vehicles (ratio, mutual, gate, consistency), and each method of
`fusion.association`.
""",
    run=run,
    seeds=16,
    frames=160,
)
