# SPDX-License-Identifier: Apache-2.0
"""The cost of a calibration that is as wrong as a good one is."""

from __future__ import annotations

import argparse

from uav_vslam.argument_types import whole_number
from uav_vslam.studies.engine.study import Findings, Progress, Study

RENDERED = 5


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the number of rendered flights."""
    text = f"of them also over rendered images; 0: none (default {RENDERED})"
    parser.add_argument("--rendered-seeds", type=whole_number(0), default=RENDERED, metavar="N", help=text)


def run(args: argparse.Namespace, seeds: list[int], progress: Progress) -> Findings:
    """Fly with each error of the calibration alone, and with all."""
    from uav_vslam.studies.engine.flights import kagaru_configs
    from uav_vslam.studies.engine.variants import CALIBRATIONS
    from uav_vslam.studies.perturbed.compute import LANDMARKS, NOTES, RENDERED, run_study
    from uav_vslam.studies.perturbed.plot import draw_perturbed

    configs = kagaru_configs(args.variant or CALIBRATIONS)
    levels = {LANDMARKS: seeds, RENDERED: seeds[: args.rendered_seeds]}
    advance = progress(sum(map(len, levels.values())))
    rows, series = run_study(configs, levels, frames=args.frames, workers=args.workers, on_seed=advance)
    return Findings(rows, NOTES, series, draw_perturbed)


STUDY = Study(
    help="calibration perturbed as a real one is: focal length, principal point, extrinsics, time offset",
    takes="half an hour",
    examples="""examples:
  uav-vslam study perturbed                               20 seeds at landmark level, 5 of them rendered
  uav-vslam study perturbed --seeds 4 --rendered-seeds 0
  uav-vslam study perturbed --seeds 4 --rendered-seeds 0 --variant rig.flexing=true,rig.attitude_sigma_deg=0.02

One vehicle alone, config kagaru. Each error but those of the disparity is drawn for each seed, with the standard
deviation that the table names.
""",
    run=run,
    add_arguments=add_arguments,
    frames=160,
    variants="calibration judged, the attitude estimated, calibration doubted",
)
