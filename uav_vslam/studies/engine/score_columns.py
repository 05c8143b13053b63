# SPDX-License-Identifier: Apache-2.0
"""The scores of many runs under the columns of a study: root mean squares of errors, means of NEES."""

from collections.abc import Mapping, Sequence
from typing import Any

from uav_vslam.evaluation.scores import ERROR_KEYS, NEES_KEYS
from uav_vslam.evaluation.study import Row
from uav_vslam.studies.engine.pool import mean, rms

COLUMN_OF = {
    "ate_m": "ate_rms_m",
    "ate_start_yaw_m": "ate_start_yaw_rms_m",
    "ate_se3_m": "ate_se3_rms_m",
    "end_m": "end_rms_m",
}  # all other scores keep their name
SCORES = tuple(COLUMN_OF.get(key, key) for key in (*ERROR_KEYS, *NEES_KEYS))


def pooled_scores(runs: Sequence[dict[str, Any]]) -> Row:
    """Return the columns of runs, each a dict as `evaluation.scores` has it; None where no run has the score."""
    errors = {COLUMN_OF.get(key, key): rms(values_of(runs, key)) for key in ERROR_KEYS}
    return errors | {key: mean(values_of(runs, key)) for key in NEES_KEYS}


def values_of(runs: Sequence[Mapping[str, Any]], key: str) -> list[float]:
    """Return the values of a score, of the runs that have it."""
    return [float(run[key]) for run in runs if run.get(key) is not None]
