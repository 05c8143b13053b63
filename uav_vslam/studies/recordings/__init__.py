# SPDX-License-Identifier: Apache-2.0
"""One flight, recorded in many ways."""

from __future__ import annotations

import argparse

from uav_vslam.studies.engine.study import Findings, Progress, Study


def run(args: argparse.Namespace, seeds: list[int], progress: Progress) -> Findings:
    """Render each seed's flight, record it in every way and fly each recording."""
    from uav_vslam.studies.recordings.compute import NOTES, study_rows

    advance = progress(len(seeds), "flights, each in all ways")
    return Findings(study_rows(seeds, frames=args.frames, workers=args.workers, on_flight=advance), NOTES)


STUDY = Study(
    help="one rendered flight as strangers record it: other topics, files, encodings, clocks, frames and lenses",
    takes="an hour",
    examples="""examples:
  uav-vslam study recordings                  six flights
  uav-vslam study recordings --seeds 1 --frames 40

Each recording is some 2.5 MB a frame, in the folder for temporary files.
""",
    run=run,
    seeds=6,
    frames=160,
)
