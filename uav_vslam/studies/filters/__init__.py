# SPDX-License-Identifier: Apache-2.0
"""The filters against each other."""

from __future__ import annotations

import argparse

from uav_vslam.argument_types import positive_number, whole_number
from uav_vslam.studies.engine.study import Findings, Progress, Study


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the flights of the noise scales."""
    parser.add_argument(
        "--vehicles", type=whole_number(1), default=2, help="of each seed, each alone and a run (default 2)"
    )
    parser.add_argument("--runs", type=whole_number(1), default=10, help="runs of each noise scale (default 10)")
    parser.add_argument("--steps", type=whole_number(2), default=100, help="frames of each of these runs (default 100)")
    parser.add_argument(
        "--altitude", type=positive_number, default=20.0, help="of the noise scales' flight [m] (default 20)"
    )
    parser.add_argument(
        "--speed", type=positive_number, default=6.0, help="of the noise scales' flight [m/s] (default 6)"
    )


def run(args: argparse.Namespace, seeds: list[int], progress: Progress) -> Findings:
    """Fly the default flight, and the thesis's noise scales with both extractors' noise."""
    from uav_vslam.studies.engine.own_only import run_trials
    from uav_vslam.studies.engine.scores import breakdowns
    from uav_vslam.studies.filters import compute as study
    from uav_vslam.studies.filters.plot import draw_filters

    flights = [study.consistency_trial(frames=args.frames, vehicles=args.vehicles)]
    options = {"frames": args.steps, "altitude": args.altitude, "speed": args.speed}
    scales = {extractor: study.noise_trials(extractor, **options) for extractor in study.MEASURED}
    noisy_seeds = range(args.first_seed, args.first_seed + args.runs)
    advance = progress(len(seeds) + sum(map(len, scales.values())) * args.runs)
    nominal = run_trials(flights, seeds, workers=args.workers, on_job=advance)
    noisy = {
        extractor: run_trials(trials, noisy_seeds, workers=args.workers, on_job=advance)
        for extractor, trials in scales.items()
    }
    rows = study.consistency_rows(nominal)
    rows += [row for extractor, found in noisy.items() for row in study.noise_rows(found, extractor)]
    notes = study.NOTES | breakdowns([*nominal, *(run for found in noisy.values() for run in found)])
    return Findings(rows, notes, draw=draw_filters)


STUDY = Study(
    help="landmark level: EIF, EKF, UKF and UHF with every state model, and the thesis's tables of section 4.7",
    takes="two hours",
    examples="""examples:
  uav-vslam study filters                              20 seeds, 10 runs a noise scale
  uav-vslam study filters --seeds 4 --runs 2           a quick check; minutes
  uav-vslam study filters --altitude 70 --speed 20     the noise scales on the flight of the first table

Landmark level: points on the ground in place of images. The first table flies the default scenario (1 px, ADIS16480);
the others the thesis's noise scales w1 to w4, with 10 px^2 on each pixel coordinate as SIFT's, and with what SURF was
measured to differ from SIFT by: more noise, fewer points, wrong matches.
""",
    run=run,
    add_arguments=add_arguments,
    frames=160,
)
