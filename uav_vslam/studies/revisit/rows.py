# SPDX-License-Identifier: Apache-2.0
"""The figures of flights that return to their start."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from uav_vslam.evaluation.segments import distances_m
from uav_vslam.evaluation.study import Row
from uav_vslam.evaluation.trajectory import Trajectory
from uav_vslam.slam.landmark_map import LONG_FRAMES
from uav_vslam.studies.engine.pool import CONFIDENCE, grouped, mean, ratio, ratio_interval, rms
from uav_vslam.studies.engine.score_columns import SCORES
from uav_vslam.studies.engine.scores import FAILURE_RULE, end_error_m, is_finished, pooled, position_errors_m
from uav_vslam.studies.revisit.compute import FALSE_BEYOND_M, FORGETTING, NOISE, TWIN_SHARE, Loop

Array = NDArray[np.float64]

RETURN_M = 50.0  # closer to its start than this, after half the flight, a vehicle is about to revisit known ground

NOTES = {
    "Flights": "one vehicle alone, ADIS16480, 2.05 km round and 0.1 km on over known ground; all methods get the same "
    "features. rendered: images rendered for the front end of config kagaru; landmark: points, 1 px, "
    f"of which {NOISE.missed_share:.0%} are missed in each frame, {NOISE.lookalike_share:.0%} seen some pixels beside, "
    f"and {TWIN_SHARE:.0%} have the descriptor of another one a few metres away",
    "Drift": f"error at the first frame that is within {RETURN_M:.0f} m of the start again, before any loop is closed",
    "Ratio": f"end error over that of the flights with {FORGETTING}; ratio_low and ratio_high: {CONFIDENCE:.0%} of the "
    "bootstrap over seeds, from three seeds on",
    "Closures": f"landmarks re-observed after {LONG_FRAMES} frames or more without them, a flight; false, of all "
    f"flights: another landmark, or a point without identity more than {FALSE_BEYOND_M} m from where the landmark was "
    "first seen; closed: flights with any that is right",
    "Time": "ms_per_frame is that of the back end alone",
    "Failures": FAILURE_RULE,
}


def revisit_rows(loops: Sequence[Loop]) -> list[Row]:
    """Return a row per level and method."""
    rows: list[Row] = []
    for level, of_level in grouped(loops, lambda loop: loop.level).items():
        by_method = grouped(of_level, lambda loop: loop.run.name)
        forgetting = by_method.get(FORGETTING, [])
        rows += [{"method": name, "condition": level, **_row(x, forgetting)} for name, x in by_method.items()]
    return rows


def revisit_series(loops: Sequence[Loop]) -> list[Row]:
    """Return a curve per level and method over the flights that were finished, and each seed's end error."""
    curves = []
    for (level, name), found in grouped(loops, lambda loop: (loop.level, loop.run.name)).items():
        runs = [loop.run for loop in found if is_finished(loop.run)]
        if runs:
            errors = np.sqrt(np.mean([np.square(position_errors_m(run)) for run in runs], axis=0))
            curves.append(
                {
                    "method": name,
                    "condition": level,
                    "distance_m": np.round(distances_m(runs[0].truth), 2).tolist(),
                    "error_m": np.round(errors, 4).tolist(),
                    "seeds": [run.seed for run in runs],
                    "ends_m": [round(end_error_m(run), 4) for run in runs],
                }
            )
    return curves


def _row(loops: Sequence[Loop], forgetting: Sequence[Loop]) -> Row:
    figures = pooled([loop.run for loop in loops])
    ends, reference = _ends(loops), _ends(forgetting)
    common = sorted(set(ends) & set(reference))
    squares, squares_without = (np.array([end[seed] ** 2 for seed in common]) for end in (ends, reference))
    return {
        "drift_before_rms_m": rms(
            [position_errors_m(x.run)[back_at(x.run.truth)] for x in loops if is_finished(x.run)]
        ),
        "end_rms_m": figures["end_rms_m"],
        "end_ratio_to_forgetting": ratio(
            rms([ends[seed] for seed in common]), rms([reference[seed] for seed in common])
        ),
        **(ratio_interval(squares_without, squares) if loops[0].run.name != FORGETTING else {}),
        **{key: figures[key] for key in SCORES if key != "end_rms_m"},
        "nees_position_end": figures["nees_position_end"],
        "closed": sum(bool((~loop.false).any()) for loop in loops),
        "closures": mean([float(len(loop.false)) for loop in loops]),
        "false_closures": sum(int(loop.false.sum()) for loop in loops),
        "ms_per_frame": figures["ms_per_frame"],
        "failures": figures["failures"],
        "runs": figures["runs"],
    }


def back_at(truth: Trajectory) -> int:
    """Return the first frame of the second half that is near the start again; the last one if none is."""
    away = np.linalg.norm(truth.positions[:, :2] - truth.positions[0, :2], axis=1)
    half = len(truth) // 2
    near = np.flatnonzero(away[half:] < RETURN_M)
    return half + int(near[0]) if len(near) else len(truth) - 1


def _ends(loops: Sequence[Loop]) -> dict[int, float]:
    return {loop.run.seed: end_error_m(loop.run) for loop in loops if is_finished(loop.run)}
