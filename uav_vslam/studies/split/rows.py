# SPDX-License-Identifier: Apache-2.0
"""Tables and curves of a cut flight."""

import functools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from uav_vslam.datasets.cutting import Cut
from uav_vslam.evaluation.consistency import nees, summarise
from uav_vslam.evaluation.pairing import pair_with_truth
from uav_vslam.evaluation.study import TABLE, Row
from uav_vslam.studies.engine.pool import mean, mean_interval, ratio, ratio_interval, rms, root_mean
from uav_vslam.studies.engine.recorded_flights import RecordedFlight
from uav_vslam.studies.split.compute import C_SLAM, INS, METHODS, S_SLAM, Outcome
from uav_vslam.types import NS_PER_S

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class _Score:
    """One vehicle of one seed: (F, 3) errors [m], and the mean position NEES over 3."""

    error: Array
    nees: float


def leg_rows(cut: Cut) -> list[Row]:
    """Return a table of the legs, and one of what each two have in common."""
    legs: list[Row] = [
        {
            TABLE: "Legs",
            "method": vehicle.name,
            "condition": "leg",
            "leg_start_s": (vehicle.first_ns - cut.zero_ns) / NS_PER_S,
            "leg_end_s": (vehicle.last_ns - cut.zero_ns) / NS_PER_S,
            "frames": vehicle.frames,
        }
        for vehicle in cut.vehicles
    ]
    meetings: list[Row] = [
        {
            TABLE: "Overlap",
            "method": ", ".join(names),
            "condition": "legs",
            "overlap": met.overlap,
            "overlapping_views": met.shared,
            "heading_difference_deg": met.heading_deg,
            "view_difference_deg": met.view_angle_deg,
            "passes_apart_s": met.gap_s,
        }
        for names, met in cut.meetings.items()
    ]
    return legs + meetings


def error_rows(legs: list[RecordedFlight], outcomes: Sequence[Outcome]) -> list[Row]:
    """Return the rows of each vehicle, then those of all together."""
    good = [outcome for outcome in outcomes if not outcome.failure]
    names = [leg.vehicle for leg in legs]
    scores = {
        (label, leg.vehicle): [_score(leg, outcome, label) for outcome in good] for label in METHODS for leg in legs
    }
    rows: list[Row] = []
    for condition, members in [*((name, [name]) for name in names), ("both" if len(names) == 2 else "all", names)]:
        own = _mean_squares([scores[S_SLAM, name] for name in members])
        for label in METHODS:
            row = _figures([scores[label, name] for name in members])
            if label in C_SLAM.values():
                other = _mean_squares([scores[label, name] for name in members])
                row |= {"ratio_to_s_slam": ratio(root_mean(other), root_mean(own)), **ratio_interval(own, other)}
                row["packets_used"] = sum(outcome.packets_used[label][name] for name in members for outcome in good)
            counts = {"failures": len(outcomes) - len(good), "runs": len(outcomes)}
            rows.append({TABLE: "Errors", "method": label, "condition": condition} | row | counts)
    return rows


def _figures(scores: list[list[_Score]]) -> Row:
    """Return the figures of some vehicles' runs; what compares with S-SLAM is left open, but has its place."""
    end_m = [float(np.linalg.norm(one.error[-1])) for of_one in scores for one in of_one]
    of_seeds = np.mean([[one.nees for one in of_one] for of_one in scores], axis=0)
    return {
        "end_rms_m": rms(end_m),
        "ate_rms_m": root_mean(_mean_squares(scores)),
        "height_rms_m": root_mean(_mean_squares(scores, axes=slice(2, 3))),
        **dict.fromkeys(("ratio_to_s_slam", "ratio_low", "ratio_high")),
        "nees_position": mean(of_seeds),
        **mean_interval("nees_position", of_seeds),
        "packets_used": None,
    }


def failure_note(outcomes: Sequence[Outcome]) -> dict[str, str]:
    """Return why runs failed, the first reason; no note if none did."""
    reasons = [f"seed {outcome.seed}: {outcome.failure}" for outcome in outcomes if outcome.failure]
    return {"Failures": reasons[0]} if reasons else {}


def series_of(legs: list[RecordedFlight], outcomes: Sequence[Outcome]) -> list[Row]:
    """Return for plots: the tracks of the first seed, and the root mean square of the errors over the seeds.

    Both are given where the tracks of all seeds have a pose.
    """
    good = [outcome for outcome in outcomes if not outcome.failure]
    series: list[Row] = []
    for leg in legs if good else []:
        for label in METHODS:
            pairs = [pair_with_truth(outcome.tracks[label][leg.vehicle], leg.truth) for outcome in good]
            stamps_ns = functools.reduce(np.intersect1d, [track.stamps_ns for track, _ in pairs])
            track, truth = (one.select(np.isin(one.stamps_ns, stamps_ns)) for one in pairs[0])
            if label == INS:
                series.append(_curve("Truth", leg, truth.stamps_ns, truth.positions, np.zeros_like(truth.positions)))
            errors = [(own.positions - true.positions)[np.isin(own.stamps_ns, stamps_ns)] for own, true in pairs]
            error = np.sqrt(np.mean(np.square(errors), axis=0))
            series.append(_curve(label, leg, track.stamps_ns, track.positions, error))
    return series


def _curve(label: str, leg: RecordedFlight, stamps_ns: NDArray[np.int64], positions: Array, error: Array) -> Row:
    axes = ("east", "north", "up")
    return {
        "method": label,
        "condition": leg.vehicle,
        "time_s": ((stamps_ns - leg.frame_stamps_ns[0]) / NS_PER_S).tolist(),
        **{f"{axis}_m": positions[:, k].tolist() for k, axis in enumerate(axes)},
        **{f"error_{axis}_rms_m": error[:, k].tolist() for k, axis in enumerate(axes)},
    }


def _score(leg: RecordedFlight, outcome: Outcome, label: str) -> _Score:
    track = outcome.tracks[label][leg.vehicle]
    paired, truth = pair_with_truth(track, leg.truth)
    consistency = nees(track, leg.truth)
    return _Score(paired.positions - truth.positions, summarise(consistency.position).mean if consistency else np.nan)


def _mean_squares(scores: list[list[_Score]], axes: slice = slice(0, 3)) -> Array:
    """Return (S,) of each seed the mean squared error over the vehicles' frames [m^2]; a vehicle counts once."""
    of_vehicles = [[float((one.error[:, axes] ** 2).sum(axis=1).mean()) for one in of_one] for of_one in scores]
    return np.mean(of_vehicles, axis=0)
