# SPDX-License-Identifier: Apache-2.0
"""What cooperation gains, and whether it stays consistent."""

from __future__ import annotations

import argparse

from uav_vslam.studies.engine.study import Findings, Progress, Study

PARTS = ("schemes", "association", "network", "fleets")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the parts."""
    parser.add_argument("--parts", nargs="+", choices=PARTS, default=PARTS, help="which (default all)")


def run(args: argparse.Namespace, seeds: list[int], progress: Progress) -> Findings:
    """Fly the chosen parts."""
    from uav_vslam.studies.engine import fusion_parts
    from uav_vslam.studies.engine.fusion_plot import draw_fusion
    from uav_vslam.studies.fusion.compute import ASSOCIATION_NOTES, NOTES, PARTS

    parts = [part for name in args.parts for part in PARTS[name](args.frames)]
    rows = fusion_parts.run_parts(parts, seeds, workers=args.workers, on_job=progress(len(parts) * len(seeds)))
    of_part = {"association": ASSOCIATION_NOTES, "network": fusion_parts.PARTING_NOTES}
    notes = NOTES | fusion_parts.NOTES
    for name in args.parts:
        notes |= of_part.get(name, {})
    return Findings(rows, notes, draw=draw_fusion)


STUDY = Study(
    help="landmark level: fusion schemes and association, the thesis's among them; bad radios; fleets of 2, 4 and 8",
    takes="over an hour",
    examples="""examples:
  uav-vslam study fusion                                20 seeds of everything
  uav-vslam study fusion --parts schemes --seeds 4      a first look; minutes
  uav-vslam study fusion --parts association            the methods of `fusion.association` (thesis, section 7.4)
  uav-vslam study fusion --parts network fleets
""",
    run=run,
    add_arguments=add_arguments,
    frames=160,
)
