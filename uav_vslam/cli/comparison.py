# SPDX-License-Identifier: Apache-2.0
"""What `uav-vslam evaluate` does with trajectory files and results folders: all estimates in one table and one plot."""

from __future__ import annotations

import argparse
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from uav_vslam.cli.messages import say, warn

if TYPE_CHECKING:
    from uav_vslam.evaluation.comparison import Figures, PairedRun, Run
    from uav_vslam.evaluation.trajectory import Trajectory


def compare_files(args: argparse.Namespace) -> int:
    """Score all estimates, print the tables, and write figures and plot."""
    from uav_vslam.evaluation.comparison import compare, pair_run
    from uav_vslam.evaluation.output import write_comparison
    from uav_vslam.evaluation.pairing import MAX_GAP_S
    from uav_vslam.evaluation.revision import git_revision
    from uav_vslam.report.comparison_plot import write_comparison_plot
    from uav_vslam.report.comparison_table import print_comparison

    _refuse_times_without_kitti(args)
    max_gap_s = args.max_gap or MAX_GAP_S
    runs = [pair_run(run, max_gap_s=max_gap_s) for run in _runs(args)]
    for run in runs:
        _report_partial(run)
    name = args.name or "comparison"
    tree = {
        "inputs": [str(path.resolve()) for path in args.inputs],
        "truth": str(args.truth.resolve()) if args.truth else None,  # of the results folders themselves
        "truth_offset_s": args.truth_offset,
        "max_gap_s": max_gap_s,
    } | compare(runs, name=name, git=git_revision(), lengths_m=args.segments)
    plot = partial(write_comparison_plot, runs, alignment=args.alignment, title=name)
    try:
        print_comparison(tree)  # first: a full disk must not cost it
    finally:  # nor a reader that has closed the pipe the results
        folder = write_comparison(tree, args.results, plot=None if args.no_plots else plot)
    _report_offsets(runs, tree, args.truth_offset)
    print(f"written to {folder}")
    return 0


def _refuse_times_without_kitti(args: argparse.Namespace) -> None:
    from uav_vslam.errors import ConfigError
    from uav_vslam.evaluation.files.reading import is_kitti

    files = [path for path in (*args.inputs, args.truth) if path is not None and not path.is_dir()]
    if args.times is not None and not any(map(is_kitti, files)):
        raise ConfigError("--times belongs to KITTI files, and none is given; all others have stamps of their own")


def _runs(args: argparse.Namespace) -> list[Run]:
    from uav_vslam.evaluation.clock_offset import later
    from uav_vslam.evaluation.files.reading import read_trajectory
    from uav_vslam.evaluation.files.results_folder import distinct_names

    truth = None
    if args.truth is not None:
        truth = read_trajectory(args.truth, times=args.times, numbered=True)
    runs = [
        run
        for path, name in zip(args.inputs, distinct_names(args.inputs), strict=True)
        for run in (_of_folder(path, name, truth) if path.is_dir() else _of_file(path, name, truth, args.times))
    ]
    return [replace(run, truth=later(run.truth, args.truth_offset)) for run in runs]


def _of_file(path: Path, name: str, truth: Trajectory | None, times: Path | None) -> list[Run]:
    from uav_vslam.errors import TrajectoryFileError
    from uav_vslam.evaluation.comparison import Run
    from uav_vslam.evaluation.files.reading import read_trajectory

    if truth is None:
        raise TrajectoryFileError(f"{path} needs a ground truth; give --truth FILE")
    return [Run(name, "", read_trajectory(path, times=times, reference=truth), truth)]


def _of_folder(folder: Path, name: str, truth: Trajectory | None) -> list[Run]:
    """Return the estimates of each vehicle of a results folder; their own truth counts unless another is given."""
    from uav_vslam.errors import ConfigError, TrajectoryFileError
    from uav_vslam.evaluation.comparison import Run
    from uav_vslam.evaluation.files.results_folder import at_equal_stamps, read_results
    from uav_vslam.evaluation.summary import TRACK_NAMES

    runs, vehicles = [], read_results(folder)
    if truth is not None and len(vehicles) > 1:
        names = " and ".join(vehicles)
        raise ConfigError(
            f"{folder} holds {names}, and --truth is of one vehicle: name its files, such as "
            f"{folder / next(iter(vehicles))}_s_slam.tum"
        )
    for vehicle, tracks in vehicles.items():
        reference = truth or tracks.get("truth")
        if reference is None:
            raise TrajectoryFileError(f"{folder} holds no ground truth of {vehicle}; give --truth FILE")
        estimates = at_equal_stamps(tracks)
        runs += [Run(name, f"{vehicle} {TRACK_NAMES[track]}", found, reference) for track, found in estimates.items()]
    return runs


def _report_offsets(runs: list[PairedRun], tree: Figures, given_s: float) -> None:
    from uav_vslam.evaluation.clock_offset import ClockOffset

    for run, figures in zip(runs, tree["runs"], strict=True):
        if offset := figures["clock_offset"]:
            warn(f"{run.run.label}: {ClockOffset(**offset).text(given_s)}")


def _report_partial(run: PairedRun) -> None:
    found, poses = len(run.estimate), len(run.run.estimate)
    if found < poses:
        say(f"{run.run.label}: {found} of {poses} poses have ground truth; only they count")
