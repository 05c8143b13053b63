# SPDX-License-Identifier: Apache-2.0
"""Flights without a start state, and with a wrong one."""

from __future__ import annotations

import argparse

from uav_vslam.studies.engine.study import Findings, Progress, Study


def run(args: argparse.Namespace, seeds: list[int], progress: Progress) -> Findings:
    """Fly without a start state with both grades of inertial unit, and with each wrong start state."""
    from uav_vslam.studies.start.compute import GRADES, NOTES, WRONGS, study_rows

    advance = progress((len(GRADES) + len(WRONGS)) * len(seeds))
    return Findings(study_rows(GRADES, seeds, frames=args.frames, workers=args.workers, on_job=advance), NOTES)


STUDY = Study(
    help="landmark level: flights without a start state or with a wrong one",
    takes="minutes",
    examples="""examples:
  uav-vslam study start --seeds 20
""",
    run=run,
    frames=160,
)
