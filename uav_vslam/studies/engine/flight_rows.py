# SPDX-License-Identifier: Apache-2.0
"""Flies many methods and seeds, and pools the figures over seeds and vehicles: rows, and NEES over time."""

import functools
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uav_vslam.evaluation.consistency import Nees
from uav_vslam.evaluation.study import Row
from uav_vslam.evaluation.summary import TRACK_NAMES, TRACKS
from uav_vslam.studies.engine.flights import Method, Outcome, run_seed
from uav_vslam.studies.engine.pool import in_pool, mean, mean_interval, ratio, ratio_interval, rms
from uav_vslam.studies.engine.score_columns import pooled_scores, values_of
from uav_vslam.types import NS_PER_S

Array = NDArray[np.float64]

# What of an `Outcome` is a track's time: of the front end, and of all after it.
TIMES = {
    "ins": ("", ""),
    "s_slam": ("ms_front_end", "ms_per_frame"),
    "c_slam": ("ms_front_end", "ms_per_frame"),
    "smoothed": ("", "ms_smoothing"),
}


def fly_all(
    methods: list[Method], seeds: list[int], *, workers: int, on_seed: Callable[[], None] = lambda: None
) -> list[Outcome]:
    """Fly every method on every seed; return the outcomes in the order of the seeds.

    Args:
        methods: what to compare.
        seeds: of the flights; every method flies the same ones.
        workers: processes.
        on_seed: called when a seed is done.
    """
    flown = in_pool(functools.partial(run_seed, methods), seeds, workers, on_seed)
    return [outcome for found in flown for outcome in found]


def flight_rows(methods: Sequence[Method], outcomes: Sequence[Outcome]) -> list[Row]:
    """Return a row for each method and track; the INS is the same whatever the method."""
    rows = []
    for number, method in enumerate(methods):
        first = method.condition not in {earlier.condition for earlier in methods[:number]}
        tracks = TRACKS if first else TRACKS[1:]
        rows += method_rows(method, [o for o in outcomes if o.method == method], tracks)
    return rows


def method_rows(method: Method, outcomes: Sequence[Outcome], tracks: Sequence[str]) -> list[Row]:
    """Return one row per track that was flown; the INS's covariance is not scored."""
    good = [outcome for outcome in outcomes if outcome.figures]
    scores = {track: scores_of(good, track) for track in TRACKS}
    ends = {track: rms(values_of(scores[track], "end_m")) for track in TRACKS}
    return [
        {
            "method": TRACK_NAMES[track] if track == "ins" else f"{TRACK_NAMES[track]} {method.name}",
            "condition": method.condition,
            **pooled_scores(scores[track]),
            **mean_interval("nees_position", _of_seeds(good, track, "nees_position", mean)),
            **(_ratio_to_own(good, track) if method.scenario.vehicles > 1 else {}),
            "end_ratio_to_ins": ratio(ends[track], ends["ins"]),
            "processed_share": mean([outcome.processed for outcome in good]),
            "failures": len(outcomes) - len(good),
            "runs": len(outcomes),
            "ms_front_end": _ms(good, TIMES[track][0]),
            "ms_per_frame": _ms(good, TIMES[track][1]),
        }
        for track in tracks
        if scores[track] or not good
    ]


def nees_series(methods: Sequence[Method], outcomes: Sequence[Outcome]) -> list[Row]:
    """Return the mean NEES of position and attitude over time for each method and SLAM track.

    Runs that lost frames are left out. `runs` of a fused track counts one vehicle of each seed: the estimates of
    cooperating vehicles are not independent.
    """
    series = []
    for method in methods:
        for track in TRACKS[1:]:
            found = [_whole(outcome, track) for outcome in outcomes if outcome.method == method]
            whole = [curve for curves in found for curve in curves]
            if whole:
                runs = len(whole) if track != "c_slam" else sum(bool(curves) for curves in found)
                label = {"method": f"{TRACK_NAMES[track]} {method.name}", "condition": method.condition, "runs": runs}
                series.append(label | _mean_curve(whole))
    return series


def _whole(outcome: Outcome, track: str) -> list[Nees]:
    """Return the curves of a track that have every frame."""
    return [curve for curve in outcome.curves.get(track, ()) if len(curve.stamps_ns) == outcome.method.scenario.frames]


def _mean_curve(curves: Sequence[Nees]) -> dict[str, list[float]]:
    stamps_ns = curves[0].stamps_ns
    return {
        "time_s": np.round((stamps_ns - stamps_ns[0]) / NS_PER_S, 3).tolist(),
        "nees_position": np.round(np.mean([curve.position for curve in curves], axis=0), 4).tolist(),
        "nees_rotation": np.round(np.mean([curve.rotation for curve in curves], axis=0), 4).tolist(),
    }


def _ratio_to_own(outcomes: Sequence[Outcome], track: str) -> Row:
    own, other = (rms(values_of(scores_of(outcomes, name), "ate_m")) for name in ("s_slam", track))
    squares = (_of_seeds(outcomes, name, "ate_m") ** 2 for name in ("s_slam", track))
    return {"ratio_to_s_slam": ratio(other, own), **ratio_interval(*squares)}


def scores_of(outcomes: Sequence[Outcome], track: str) -> list[dict[str, Any]]:
    """Return the scores of every run of a track."""
    return [scores for o in outcomes for scores in (o.figures or {}).get(track, {}).values()]


def _of_seeds(
    outcomes: Sequence[Outcome], track: str, key: str, pool: Callable[[Sequence[float]], float | None] = rms
) -> Array:
    """Return (S,) figures of each seed, pooled over its vehicles; NaN where there are none."""
    return np.array([pool(values_of(scores_of([outcome], track), key)) for outcome in outcomes], dtype=np.float64)


def _ms(outcomes: Sequence[Outcome], name: str) -> float | None:
    values = [getattr(outcome, name) for outcome in outcomes] if name else []
    return mean([value for value in values if np.isfinite(value)])
