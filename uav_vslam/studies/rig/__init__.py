# SPDX-License-Identifier: Apache-2.0
"""The cost of a rig that deviates from its calibration."""

from __future__ import annotations

import argparse

from uav_vslam.studies.engine.study import Findings, Progress, Study


def run(args: argparse.Namespace, seeds: list[int], progress: Progress) -> Findings:
    """Fly with each rig."""
    from uav_vslam.simulation.scenario import Scenario
    from uav_vslam.studies.engine.flights import kagaru_configs
    from uav_vslam.studies.engine.variants import CALIBRATIONS
    from uav_vslam.studies.rig.compute import NOTES, conditions, run_study
    from uav_vslam.studies.rig.plot import draw_rig

    scenario, configs = Scenario(frames=args.frames, vehicles=1), kagaru_configs(args.variant or CALIBRATIONS)
    advance = progress(len(conditions(scenario)) * len(seeds))
    return Findings(run_study(scenario, configs, seeds, workers=args.workers, on_flight=advance), NOTES, draw=draw_rig)


STUDY = Study(
    help="rendered images: a right camera that vibrates, is turned or shifted, with and without the error as a state",
    takes="an hour",
    examples="""examples:
  uav-vslam study rig                                  5 seeds, 11 rigs, 160 rendered pairs each
  uav-vslam study rig --seeds 1 --workers 1            a quick check; about ten minutes
  uav-vslam study rig --seeds 1 --variant rig.flexing=true --variant rig.flexing=true,rig.attitude_sigma_deg=0.1

One vehicle alone, config kagaru. The extrinsic attitude is a state where `rig.flexing` is true.
Otherwise an error of the disparity is estimated once the motion shows it, and from the start if it is doubted.
""",
    run=run,
    seeds=5,
    frames=160,
    variants="rig.flexing false and true, and rig.miscalibrated_probability=0.5",
)
