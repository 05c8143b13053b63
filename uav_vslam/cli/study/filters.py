# SPDX-License-Identifier: Apache-2.0
"""`uav-vslam study filters`: the filters against each other."""

from __future__ import annotations

import argparse

from uav_vslam.cli.progress import progress_bar
from uav_vslam.cli.study.common import add_run_arguments, publish, seeds_of

HELP = "EIF, EKF, UKF and UHF with every state model: consistency, and the thesis's tables of section 4.7"
EXAMPLES = """examples:
  uav-vslam study filters                              20 seeds, 10 runs a noise scale; two hours on 2 cores
  uav-vslam study filters --seeds 4 --runs 2           a first look; minutes
  uav-vslam study filters --altitude 70 --speed 20     the noise scales on the flight of the first table

Landmark level: points on the ground in place of images. The first table flies the default scenario (1 px, ADIS16480);
the others the thesis's noise scales w1 to w4, with 10 px^2 on each pixel coordinate as SIFT's, and with what SURF was
measured to differ from SIFT by: more noise, fewer points, wrong matches.
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
    from uav_vslam.studies.engine.own_only import run_trials
    from uav_vslam.studies.engine.scores import breakdowns
    from uav_vslam.studies.filters.compute import (
        MEASURED,
        NOTES,
        consistency_rows,
        consistency_trial,
        noise_rows,
        noise_trials,
    )
    from uav_vslam.studies.filters.plot import draw_filters

    flights = [consistency_trial(frames=args.frames, vehicles=args.vehicles)]
    options = {"frames": args.steps, "altitude": args.altitude, "speed": args.speed}
    scales = {extractor: noise_trials(extractor, **options) for extractor in MEASURED}
    seeds, runs = seeds_of(args), list(range(1, args.runs + 1))
    with progress_bar("study filters", len(seeds) + sum(map(len, scales.values())) * len(runs)) as advance:
        calm = run_trials(flights, seeds, workers=args.workers, on_job=advance)
        noisy = {
            extractor: run_trials(trials, runs, workers=args.workers, on_job=advance)
            for extractor, trials in scales.items()
        }
    rows = consistency_rows(calm) + [row for extractor, found in noisy.items() for row in noise_rows(found, extractor)]
    notes = NOTES | breakdowns([*calm, *(run for found in noisy.values() for run in found)])
    return publish("filters", rows, seeds, args.results, notes=notes, plot=draw_filters)
