# SPDX-License-Identifier: Apache-2.0
"""The thesis's own cooperative simulation."""

from __future__ import annotations

import argparse

from uav_vslam.studies.engine.study import Findings, Progress, Study


def run(args: argparse.Namespace, seeds: list[int], progress: Progress) -> Findings:
    """Fly all modes, and the first seed once more for the figures."""
    from uav_vslam.studies.engine import fusion_parts
    from uav_vslam.studies.thesis.compute import NOTES, modes
    from uav_vslam.studies.thesis.plot import draw_thesis

    parts = modes(args.frames)
    rows = fusion_parts.run_parts(parts, seeds, workers=args.workers, on_job=progress(len(parts) * len(seeds)))
    return Findings(rows, fusion_parts.NOTES | NOTES, draw=draw_thesis(parts, seeds[0]))


STUDY = Study(
    help="landmark level: the thesis's cooperative simulation (7.3.2) with its three communication modes",
    takes="half an hour",
    examples="""examples:
  uav-vslam study thesis                   20 seeds, 6 and 10 px
  uav-vslam study thesis --seeds 2         a quick check; minutes
""",
    run=run,
    frames=360,
)
