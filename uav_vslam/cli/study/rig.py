# SPDX-License-Identifier: Apache-2.0
"""`uav-vslam study rig`: what a rig that is not as it was calibrated costs."""

from __future__ import annotations

import argparse

from uav_vslam.cli.progress import progress_bar
from uav_vslam.cli.study.common import add_run_arguments, add_variants, configs_of, publish, seeds_of

HELP = "a right camera that vibrates or is turned, with and without its attitude as a state"
EXAMPLES = """examples:
  uav-vslam study rig                                  5 seeds, 9 rigs, 160 rendered pairs each; about an hour
  uav-vslam study rig --seeds 1 --workers 1            a first look; about ten minutes
  uav-vslam study rig --seeds 1 --variant rig.flexing=true --variant rig.flexing=true,rig.attitude_sigma_deg=0.1

One vehicle alone, config kagaru. The extrinsic attitude is a state where `rig.flexing` is true.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the study's arguments."""
    add_run_arguments(parser, seeds=5)
    parser.add_argument("--frames", type=int, default=160, help="frames of each flight (default 160)")
    add_variants(parser, "rig.flexing false and true")


def run(args: argparse.Namespace) -> int:
    """Run the study; print its table, write and draw it."""
    from uav_vslam.simulation.scenario import Scenario
    from uav_vslam.studies.rig.compute import NOTES, VARIANTS, conditions, run_study
    from uav_vslam.studies.rig.plot import draw_rig

    scenario, seeds = Scenario(frames=args.frames, vehicles=1), seeds_of(args)
    configs = configs_of(args, VARIANTS)
    with progress_bar("study rig", len(conditions(scenario)) * len(seeds)) as advance:
        rows = run_study(scenario, configs, seeds, workers=args.workers, on_look=advance)
    return publish("rig", rows, seeds, args.results, notes=NOTES, plot=draw_rig)
