# SPDX-License-Identifier: Apache-2.0
"""Computes the content of `summary.json`: errors are null without ground truth, quality and claims are not.

Everything is scored at the stamps of the own-only track, so that all estimates are compared at equal
times: the INS is interpolated to them, the fused and the smoothed track have them.
"""

import dataclasses
import math
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np

from uav_vslam.evaluation.clock_offset import clock_offset
from uav_vslam.evaluation.pairing import MAX_GAP_S
from uav_vslam.evaluation.plain import plain
from uav_vslam.evaluation.quality import claimed_figures, quality_figures
from uav_vslam.evaluation.result import FlightResult, VehicleResult
from uav_vslam.evaluation.scores import ERROR_KEYS, NEES_KEYS, error_scores, track_scores
from uav_vslam.evaluation.trajectory import Trajectory, interpolate

Figures = dict[str, Any]

TRACK_NAMES = {"ins": "INS", "s_slam": "S-SLAM", "c_slam": "C-SLAM", "smoothed": "smoothed"}
TRACKS = tuple(TRACK_NAMES)


def build_summary(result: FlightResult, *, git: str | None, alignment: str = "none") -> Figures:
    """Return the content of `summary.json`.

    Args:
        result: the flight.
        git: revision of the code, or None where it isn't known.
        alignment: a name of `ALIGNMENTS`, of the estimates to the ground truth; NEES only with "none".
    """
    vehicles = {name: _vehicle(vehicle, alignment) for name, vehicle in result.vehicles.items()}
    return dict(
        plain(
            {
                "name": result.name,
                "seed": result.seed,
                "mode": result.mode,
                "bags": list(result.bags),
                "git": git,
                "duration_s": result.duration_s,
                "realtime_factor": result.duration_s / result.wall_s if result.wall_s > 0 else None,
                "alignment": alignment,
                "vehicles": vehicles,
                "pooled": {track: _pool(vehicle[track] for vehicle in vehicles.values()) for track in TRACKS},
            }
        )
    )


def _vehicle(vehicle: VehicleResult, alignment: str) -> Figures:
    ins, _ = interpolate(vehicle.ins, vehicle.s_slam.stamps_ns, max_gap_s=MAX_GAP_S)
    distance_m = _distance(vehicle)
    offset = None if vehicle.truth is None else clock_offset(vehicle.s_slam, vehicle.truth)
    return {
        "distance_m": distance_m,
        "frames_in": vehicle.frames_in,
        "frames_processed": vehicle.frames_processed,
        "closures": vehicle.closures,
        "ins": error_scores(ins, vehicle.truth, alignment=alignment)
        | claimed_figures(_ins_at_end(vehicle), distance_m),
        **{name: _slam(getattr(vehicle, name), vehicle, alignment, distance_m) for name in TRACKS[1:]},
        "quality": quality_figures(vehicle),
        "clock_offset": dataclasses.asdict(offset) if offset else None,
        "link": dataclasses.asdict(vehicle.link) | {"dropped": dict(sorted(vehicle.link.dropped.items()))},
    }


def _distance(vehicle: VehicleResult) -> float:
    """Return the distance flown during the own-only track, by ground truth if it is of that time [m]."""
    if len(vehicle.s_slam) == 0 or vehicle.truth is None:
        return vehicle.s_slam.path_length_m
    path = vehicle.truth.between(int(vehicle.s_slam.stamps_ns[0]), int(vehicle.s_slam.stamps_ns[-1]))
    return path.path_length_m if len(path) > 1 else vehicle.s_slam.path_length_m


def _ins_at_end(vehicle: VehicleResult) -> Trajectory:
    """Return the INS up to the last own-only pose: at 200 Hz it may go on."""
    ends_ns = vehicle.s_slam.stamps_ns[-1:]
    return vehicle.ins.select(vehicle.ins.stamps_ns <= (int(ends_ns[0]) if len(ends_ns) else 0))


def _slam(track: Trajectory | None, vehicle: VehicleResult, alignment: str, distance_m: float) -> Figures | None:
    if track is None:
        return None
    common = track.select(np.isin(track.stamps_ns, vehicle.s_slam.stamps_ns))
    return track_scores(common, vehicle.truth, alignment=alignment) | claimed_figures(common, distance_m)


def _pool(figures: Iterable[Figures | None]) -> Figures | None:
    """Pool the vehicles: root mean square of the errors, mean of the NEES; None where no vehicle has the track."""
    present = [figure for figure in figures if figure is not None]
    if not present:
        return None
    pooled = {key: _pooled(present, key, _rms) for key in (*ERROR_KEYS, "sigma_end_m")}
    return pooled | {key: _pooled(present, key, _mean) for key in NEES_KEYS if key in present[0]}


def _pooled(figures: list[Figures], key: str, pool: Callable[[list[float]], float]) -> float | None:
    values = [figure[key] for figure in figures if figure[key] is not None]
    return pool(values) if values else None


def _rms(values: list[float]) -> float:
    return math.sqrt(math.fsum(value**2 for value in values) / len(values))


def _mean(values: list[float]) -> float:
    return math.fsum(values) / len(values)
