# SPDX-License-Identifier: Apache-2.0
"""All scores of one trajectory against its ground truth, under the keys of `summary.json`; null where there are none.

Of ground truth without an attitude, relative errors are null: they are expressed in the body.

The keys are those of every study's runs too, so that a score has one definition: `ATE_KEYS` names the alignments,
`RELATIVE_LENGTHS_M` the segments.
"""

import math
from typing import Any

import numpy as np

from uav_vslam.evaluation.attitude import lacks_attitude
from uav_vslam.evaluation.consistency import nees, summarise
from uav_vslam.evaluation.pairing import pair_with_truth
from uav_vslam.evaluation.segments import MotionError, motion_error
from uav_vslam.evaluation.trajectory import Trajectory
from uav_vslam.evaluation.trajectory_error import absolute_error, relative_error

Figures = dict[str, Any]

RPE_DELTA_S = 5.0
RELATIVE_LENGTHS_M = (14.0, 100.0)  # about five frames of the Kagaru flights, and the shortest of KITTI's
ATE_KEYS = {"start-yaw": "ate_start_yaw_m", "se3": "ate_se3_m"}  # beside `ate_m`, of the chosen alignment
DIRECTIONS = ("along_m", "across_m", "height_m", "attitude_mrad")  # of a relative error


def relative_key(length_m: float, what: str) -> str:
    """Return the key of a relative error: of one of `DIRECTIONS`, or "segments", their number."""
    return f"rpe_{length_m:g}m_{what}"


RELATIVE_KEYS = tuple(relative_key(length_m, what) for length_m in RELATIVE_LENGTHS_M for what in DIRECTIONS)
# Pooled by the root mean square, and by the mean.
ERROR_KEYS = ("ate_m", *ATE_KEYS.values(), "height_rms_m", "height_step_m", "end_m", *RELATIVE_KEYS)
NEES_KEYS = ("nees_position", "nees_rotation")


def track_scores(track: Trajectory, truth: Trajectory | None, *, alignment: str = "none") -> Figures:
    """Return the errors of an estimate, and its consistency.

    Args:
        track: the estimate, with its covariance if it is known.
        truth: ground truth, None if unknown.
        alignment: a name of `ALIGNMENTS`, of the estimate to the ground truth; NEES only with "none".
    """
    truth_unmoved = truth if alignment == "none" else None
    return error_scores(track, truth, alignment=alignment) | consistency_scores(track, truth_unmoved)


def error_scores(track: Trajectory, truth: Trajectory | None, *, alignment: str = "none") -> Figures:
    """Return the errors of an estimate; `ate_m`, `end_m` and `height_rms_m` are of the alignment.

    Args:
        track, truth, alignment: see `track_scores`.
    """
    absolute = None if truth is None else absolute_error(track, truth, alignment=alignment)
    oriented = None if truth is None or lacks_attitude(truth, track) else truth
    relative = None if oriented is None else relative_error(track, oriented, delta_s=RPE_DELTA_S)
    return {
        "ate_m": absolute.ate_m if absolute else None,
        **{key: _aligned_m(track, truth, name) for name, key in ATE_KEYS.items()},
        "height_rms_m": absolute.height_rms_m if absolute else None,
        "height_step_m": absolute.height_step_m if absolute else None,
        "end_m": absolute.end_m if absolute else None,
        **relative_scores(track, truth),
        "rpe_5s_m": relative.translation_rms_m if relative else None,
        "rpe_5s_deg": math.degrees(relative.rotation_rms_rad) if relative else None,
        "poses": absolute.pairs if absolute else len(track),
    }


def relative_scores(track: Trajectory, truth: Trajectory | None) -> Figures:
    """Return the errors by direction over segments of `RELATIVE_LENGTHS_M`; no alignment matters to them."""
    truth = None if truth is None or lacks_attitude(truth, track) else truth
    found: Figures = {}
    for length_m in RELATIVE_LENGTHS_M:
        error = None if truth is None else motion_error(*pair_with_truth(track, truth), length_m)
        values = _directions(error) if error and error.segments else [None] * len(DIRECTIONS)
        found |= {relative_key(length_m, what): value for what, value in zip(DIRECTIONS, values, strict=True)}
        found[relative_key(length_m, "segments")] = error.segments if error else None
    return found


def _directions(error: MotionError) -> list[float]:
    return [error.along_m, error.across_m, error.height_m, 1e3 * error.attitude_rad]


def _aligned_m(track: Trajectory, truth: Trajectory | None, alignment: str) -> float | None:
    error = None if truth is None else absolute_error(track, truth, alignment=alignment)
    return error.ate_m if error else None


def consistency_scores(track: Trajectory, truth: Trajectory | None) -> Figures:
    """Return the NEES of an estimate; None where its covariance or the truth is unknown."""
    values = None if truth is None else nees(track, truth)
    position = summarise(values.position) if values else None
    rotation = summarise(values.rotation) if values and not np.isnan(values.rotation).all() else None
    return {
        "nees_position": position.mean if position else None,
        "nees_position_end": position.end if position else None,
        "nees_rotation": rotation.mean if rotation else None,
        "nees_rotation_end": rotation.end if rotation else None,
        "nees_invalid": position.invalid if position else None,
    }
