# SPDX-License-Identifier: Apache-2.0
"""Figures of own-only runs: errors, consistency, failures, and the thesis's relative error rate."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from uav_vslam.evaluation.consistency import SKIPPED_KEYFRAMES, chi_square_band, nees, summarise
from uav_vslam.evaluation.scores import track_scores
from uav_vslam.evaluation.study import Row
from uav_vslam.evaluation.trajectory import Trajectory
from uav_vslam.studies.engine.own_only import INS, Run
from uav_vslam.studies.engine.pool import CONFIDENCE, mean, mean_interval, median, rms
from uav_vslam.studies.engine.score_columns import pooled_scores

Array = NDArray[np.float64]

NEES = "nees_position"
WINDOWS = 4  # of a flight, each of which is tested: a filter may be consistent on average and over-confident at the end

FAILURE_RULE = (
    "a run fails if the filter diverges, so that the back end stops or is re-initialised, if its estimate is not "
    "finite, or if its end error exceeds the INS's root mean square over the same runs; errors and "
    "NEES are over all runs that reached the end of their flight without re-initialisation, whatever their error"
)


def pooled(runs: Sequence[Run]) -> Row:
    """Return the figures of one candidate under one condition: root mean squares of errors, means of NEES."""
    finished = [run for run in runs if is_finished(run)]
    scores = [track_scores(run.track.estimate, run.truth) for run in finished]
    found = [(run.seed, of.position) for run in finished if (of := nees(run.track.estimate, run.truth))]
    frame_ms = [ms for run in runs for ms in run.track.frame_ms]
    return {
        **pooled_scores(scores),
        **nees_figures(found),
        "nees_position_end": mean([summarise(values).end for _, values in found]),
        "failures": failures(runs),
        "runs": len(runs),
        "restarts": sum(run.track.restarts for run in runs),
        "ms_per_frame": median(frame_ms),
    }


def nees_figures(runs: Sequence[tuple[int, Array]]) -> Row:
    """Return whether many runs are consistent: each one, at any time of the flight, and on average.

    Errors within a run are correlated, at worst fully. So a run's mean over time is tested against the band of a
    single NEES, the widest: a consistent filter leaves it in 5 % of its runs at most.

    Args:
        runs: seed and (F,) position NEES over 3 at every keyframe.

    Returns:
        Under `nees_position` the mean over keyframes after the 20th and over the runs; the other keys extend it:
        `_low` and `_high`, its bootstrap interval over seeds; `_worst_quarter`, the largest mean of a quarter
        of the flight; `_outside`, the share of runs whose mean over time is outside of the band.
    """
    counted = [(seed, values[SKIPPED_KEYFRAMES:]) for seed, values in runs]
    counted = [(seed, values) for seed, values in counted if len(values) >= WINDOWS]
    if not counted:
        return {NEES: None}
    seeds, means = np.array([seed for seed, _ in counted]), np.array([values.mean() for _, values in counted])
    interval = mean_interval(NEES, np.array([means[seeds == seed].mean() for seed in np.unique(seeds)]))
    quarters = [[part.mean() for part in np.array_split(values, WINDOWS)] for _, values in counted]
    low, high = chi_square_band(1, probability=CONFIDENCE)
    return {
        NEES: float(means.mean()),
        **interval,
        f"{NEES}_worst_quarter": float(np.mean(quarters, axis=0).max()),
        f"{NEES}_outside": float(np.mean((means < low) | (means > high))),
    }


def errors_and_nees(estimate: Trajectory, truth: Trajectory) -> tuple[Array, Array]:
    """Return distances from the truth [m] and position NEES over 3, (F,) each; the truth has all stamps."""
    found = nees(estimate, truth)
    assert found is not None
    at = np.searchsorted(truth.stamps_ns, estimate.stamps_ns)
    return np.linalg.norm(estimate.positions - truth.positions[at], axis=1), found.position


def is_finished(run: Run) -> bool:
    """Return whether a run reached the end of its flight, finite and without re-initialisation."""
    estimate = run.track.estimate
    return not run.track.failure and len(estimate) == len(run.truth) and bool(np.isfinite(estimate.positions).all())


def failures(runs: Sequence[Run]) -> int:
    """Count the runs that failed, see FAILURE_RULE; the INS itself can't."""
    ins_end_m = rms([float(np.linalg.norm(run.ins.positions[-1] - run.truth.positions[-1])) for run in runs]) or 0.0
    return sum(not is_finished(run) or (run.name != INS and end_error_m(run) > ins_end_m) for run in runs)


def breakdowns(runs: Sequence[Run]) -> dict[str, str]:
    """Return a note on why candidates failed, the first reason of each; no note if none did."""
    reasons: dict[str, str] = {}
    for run in runs:
        if run.track.failure:
            reasons.setdefault(run.name, f"{run.name} (first in {run.condition}, seed {run.seed}): {run.track.failure}")
    return {"Breakdowns": "; ".join(reasons.values())} if reasons else {}


def position_errors_m(run: Run) -> Array:
    """Return the (F,) distances of a finished run from the truth at the frames [m]."""
    return np.asarray(np.linalg.norm(run.track.estimate.positions - run.truth.positions, axis=1))


def end_error_m(run: Run) -> float:
    """Return how far from the truth a finished run ends [m]."""
    return float(np.linalg.norm(run.track.estimate.positions[-1] - run.truth.positions[-1]))


def relative_error_rate(runs: Sequence[Run]) -> float | None:
    """Return the RER of section 4.7.1 of [thesis]: errors summed over runs and steps, SLAM over INS, mean of the axes.

    One run gives that run's RER. Unfinished runs are not in the sum; None if there are no others.
    """
    finished = [run for run in runs if is_finished(run)]
    if not finished:
        return None
    slam = sum(_summed_error(run.track.estimate.positions, run.truth.positions) for run in finished)
    ins = sum(_summed_error(run.ins.positions, run.truth.positions) for run in finished)
    return float(np.mean(slam / ins))


def _summed_error(estimate: Array, truth: Array) -> Array:
    """Return the (3,) sums of absolute errors per axis; the number of steps cancels in the ratio."""
    return np.asarray(np.abs(estimate - truth).sum(axis=0))
