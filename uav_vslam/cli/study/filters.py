# SPDX-License-Identifier: Apache-2.0
"""`uav-vslam study filters`: the filters against each other."""

from __future__ import annotations

import argparse

from uav_vslam.cli.study.common import add_run_arguments, progress_bar, seeds_of, show

HELP = "EIF, EKF, UKF and UHF with every state model: consistency, and the thesis's tables of section 4.7"
EXAMPLES = """examples:
  uav-vslam study filters                              20 seeds, 10 runs a noise scale; about an hour on 2 cores
  uav-vslam study filters --seeds 4 --runs 2           a first look; minutes
  uav-vslam study filters --altitude 70 --speed 20     the noise scales on the flight of the first table

Landmark level: points on the ground in place of images, so no extractor plays a part. The first table flies the default
scenario (1 px, ADIS16480); the others the thesis's noise scales w1 to w4 with 10 px^2 on each pixel coordinate.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the study's arguments."""
    add_run_arguments(parser, seeds=20)
    parser.add_argument("--vehicles", type=int, default=2, help="of each seed, each alone and a run (default 2)")
    parser.add_argument("--frames", type=int, default=160, help="frames of the first table (default 160)")
    parser.add_argument("--runs", type=int, default=10, help="runs of each noise scale (default 10)")
    parser.add_argument("--steps", type=int, default=100, help="frames of each of these runs (default 100)")
    parser.add_argument("--altitude", type=float, default=20.0, help="of the noise scales' flight [m] (default 20)")
    parser.add_argument("--speed", type=float, default=6.0, help="of the noise scales' flight [m/s] (default 6)")


def run(args: argparse.Namespace) -> int:
    """Run the study; print its tables, write and draw them."""
    from uav_vslam.evaluation.output import write_study
    from uav_vslam.report.filter_plots import draw_filters
    from uav_vslam.studies.filters import NOTES, consistency_rows, consistency_trial, noise_rows, noise_trials
    from uav_vslam.studies.own_only import run_trials
    from uav_vslam.studies.scores import breakdowns

    flights = [consistency_trial(frames=args.frames, vehicles=args.vehicles)]
    scales = noise_trials(frames=args.steps, altitude=args.altitude, speed=args.speed)
    seeds, runs = seeds_of(args), list(range(1, args.runs + 1))
    with progress_bar("study filters", len(seeds) + len(scales) * len(runs)) as advance:
        calm = run_trials(flights, seeds, workers=args.workers, on_job=advance)
        noisy = run_trials(scales, runs, workers=args.workers, on_job=advance)
    rows, notes = consistency_rows(calm) + noise_rows(noisy), NOTES | breakdowns(calm + noisy)
    return show(write_study("study_filters", rows, seeds, args.results, notes=notes, plot=draw_filters))
