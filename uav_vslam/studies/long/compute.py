# SPDX-License-Identifier: Apache-2.0
"""A long flight over known ground: time of a frame early and late, and the gain from retained landmarks."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uav_vslam.config import RETENTION_POLICIES
from uav_vslam.evaluation.segments import distances_m
from uav_vslam.evaluation.study import Row
from uav_vslam.evaluation.trajectory_error import absolute_error
from uav_vslam.simulation.scenario import SCENARIOS
from uav_vslam.studies.engine.own_only import Run, Trial, own_only
from uav_vslam.studies.engine.pool import grouped, mean, median, rms
from uav_vslam.studies.engine.scores import FAILURE_RULE, is_finished, pooled, position_errors_m

Array = NDArray[np.float64]

FRAMES = SCENARIOS["long"].frames
SPAN = 100  # frames at the end, and after the first so many, whose times are compared
POLICIES: dict[str, dict[str, Any]] = {name: {"backend.retention": name} for name in RETENTION_POLICIES}

NOTES = {
    "Runs": "one vehicle alone at landmark level, 1 px, ADIS16480; all rows have the same flights and noise",
    "Failures": FAILURE_RULE,
    "Time": f"of this process in the back end: medians of frames {SPAN} to {2 * SPAN} and of the last {SPAN} of a run, "
    "their ratio within each run, and of all these the median over the runs",
    "Memory": f"growth_mb is the process's memory after the last frame less that after frame {SPAN}, median "
    "over the runs; the study itself keeps a pose of each frame, about 1 kB",
    "Alignment": "ate_yaw_aligned_rms_m removes the best yaw and shift, which no landmark observes: the rest is "
    "the drift that retention can prevent",
}


def long_trial(variants: Mapping[str, dict[str, Any]], *, frames: int = FRAMES) -> Trial:
    """The lawnmower flight, which revisits known ground leg after leg.

    Args:
        variants: settings to compare, by name.
        frames: of the flight.
    """
    scenario = dataclasses.replace(SCENARIOS["long"], frames=frames, vehicles=1)
    candidates = tuple(own_only(name, overrides) for name, overrides in variants.items())
    return Trial(f"lawnmower, {frames} frames", scenario, candidates)


def long_rows(runs: Sequence[Run]) -> list[Row]:
    """Return a row per variant: errors, and cost late in the flight beside cost early in it."""
    return [_row(name, found) for name, found in grouped(runs, lambda run: run.name).items()]


def long_series(runs: Sequence[Run]) -> list[Row]:
    """Return a curve per variant over the frames of the runs that were finished: error, time, landmarks."""
    finished = grouped((run for run in runs if is_finished(run)), lambda run: run.name)
    return [{"method": name, **_curve(found)} for name, found in finished.items()]


def _row(name: str, runs: list[Run]) -> Row:
    figures = pooled(runs)
    del figures["ms_per_frame"]
    finished = [run for run in runs if is_finished(run)]
    aligned = [absolute_error(run.track.estimate, run.truth, alignment="yaw") for run in finished]
    tracks = [run.track for run in finished if len(run.truth) >= 3 * SPAN]
    early = [float(np.median(track.frame_ms[SPAN : 2 * SPAN])) for track in tracks]
    late = [float(np.median(track.frame_ms[-SPAN:])) for track in tracks]
    return {
        "method": name,
        "condition": runs[0].condition,
        **figures,
        "ate_yaw_aligned_rms_m": rms([error.ate_m for error in aligned if error]),
        "ms_per_frame_early": median(early),
        "ms_per_frame_late": median(late),
        "late_to_early": median([b / a for a, b in zip(early, late, strict=True)]),
        "landmarks_mean": mean([float(track.landmarks.mean()) for track in tracks]),
        "landmarks_max": max((int(track.landmarks.max()) for track in tracks), default=None),
        "growth_mb": median([float(track.resident_mb[-1] - track.resident_mb[SPAN]) for track in tracks]),
    }


def _curve(runs: list[Run]) -> dict[str, list[float]]:
    errors = [position_errors_m(run) for run in runs]
    return {
        "distance_m": _rounded(distances_m(runs[0].truth)),
        "error_m": _rounded(np.sqrt(np.mean(np.square(errors), axis=0))),
        "ms_per_frame": _rounded(np.median([run.track.frame_ms for run in runs], axis=0)),
        "landmarks": _rounded(np.mean([run.track.landmarks for run in runs], axis=0)),
    }


def _rounded(values: Array) -> list[float]:
    return [float(value) for value in np.round(values, 4)]
