# SPDX-License-Identifier: Apache-2.0
"""Front ends over rendered flights: precision of their points, cost, and the resulting SLAM accuracy."""

import dataclasses
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uav_vslam.config import VehicleConfig
from uav_vslam.evaluation.study import Row
from uav_vslam.offline.source import FlightSource
from uav_vslam.simulation.camera_render import RenderedFlight
from uav_vslam.simulation.scenario import Scenario, SimulatedVehicle, simulate_fleet
from uav_vslam.simulation.source import SimulatedSource
from uav_vslam.simulation.terrain import Relief, relief_of
from uav_vslam.studies.engine.extracted_flights import ground_points
from uav_vslam.studies.engine.flight_rows import scores_of
from uav_vslam.studies.engine.flights import Method, Outcome, fly_sources
from uav_vslam.studies.engine.pool import in_pool, mean, ratio, rms
from uav_vslam.studies.engine.score_columns import pooled_scores, values_of
from uav_vslam.types import StereoFeatures
from uav_vslam.vision.frontends import make_frontend

Array = NDArray[np.float64]

EQUAL = "equal cameras"
CONDITIONS: dict[str, dict[str, Any]] = {
    EQUAL: {},
    "right gain 1.15, vignette 35 %": {"right_gain": 1.15, "right_vignette": 0.35},
    "motion blur 3 px": {"blur_px": 3.0},
}
FLOWN = (EQUAL,)  # the conditions in which SLAM runs as well; the others measure the points alone
BEYOND_PX = 1.0

NOTES = {
    "Points": "right pixel of every accepted feature against the true image of the ground point that the left pixel "
    f"shows: standard deviation over both coordinates, and share of those over {BEYOND_PX:.0f} px off; kept_share: "
    "points a frame over those of the same front end with equal cameras; followed_share: points that have been seen "
    "in an earlier frame, by their track",
    "Cost": "ms_per_frame: processor time of the front end alone, all threads, mean over the flight",
    "Flights": "root mean squares over seeds and vehicles, NEES of the position over 3 as mean over the frames after "
    "the 20th; c_slam_ratio_to_s_slam is 1 where vehicles have no landmark in common",
}


@dataclass(frozen=True, slots=True)
class FrontEndRun:
    """A front end's results on one flight.

    Attributes:
        method: name and condition.
        errors: (N, 2) right pixels less the truth, of all features [px].
        frames: number of frames.
        followed: number of features tracked from an earlier frame.
        ms_per_frame: processor time.
        outcome: of SLAM; None if it was not run.
    """

    method: Method
    errors: Array
    frames: int
    followed: int
    ms_per_frame: float
    outcome: Outcome | None


Job = tuple[Method, int]


def methods(scenario: Scenario, configs: Mapping[str, VehicleConfig]) -> list[Method]:
    """Return every front end under every condition."""
    return [
        Method(name, condition, dataclasses.replace(scenario, **changes), config, rendered=True)
        for condition, changes in CONDITIONS.items()
        for name, config in configs.items()
    ]


def run_study(
    compared: Sequence[Method], seeds: Sequence[int], *, workers: int, on_flight: Callable[[], None] = lambda: None
) -> list[Row]:
    """Run every front end on every flight and return the rows of `study.json`."""
    found = list(in_pool(_run_front_end, [(method, seed) for seed in seeds for method in compared], workers, on_flight))
    return [_row([seen for seen in found if seen.method == method], found) for method in compared]


def right_errors(vehicle: SimulatedVehicle, frame: int, features: StereoFeatures, relief: Relief) -> Array:
    """Return (N, 2) right pixel less the true image there of what the left pixel shows [px]."""
    T_world_body = vehicle.truth.pose(float(vehicle.frame_times_s[frame]))
    rig = vehicle.true_rig(frame)
    T_world_left = T_world_body @ rig.T_body_left
    points = ground_points(relief, T_world_left, rig.left, features.pixels[:, :2])
    expected = rig.right.project((T_world_body @ rig.T_body_right).inverse().apply(points))
    return np.asarray(features.pixels[:, 2:] - expected)


def _run_front_end(job: Job) -> FrontEndRun:
    method, seed = job
    scenario = dataclasses.replace(method.scenario, seed=seed)
    vehicles = simulate_fleet(scenario)
    relief = relief_of(scenario)
    sources: list[FlightSource] = []
    errors: list[Array] = []
    followed, busy_s = 0, 0.0
    for vehicle in vehicles:
        frontend = make_frontend(vehicle.rig, method.config.frontend, method.config.rig)
        flight: list[StereoFeatures] = []
        known: set[int] = {0}
        for k, frame in enumerate(RenderedFlight(vehicle)):
            began = time.process_time()
            features = frontend.process(frame)
            busy_s += time.process_time() - began
            flight.append(features)
            errors.append(right_errors(vehicle, k, features, relief))
            tracks = set(features.tracks.tolist())
            followed += len(tracks & known - {0})
            known |= tracks
        sources.append(SimulatedSource(vehicle, features=tuple(flight)))
    outcome = fly_sources(method, scenario, vehicles, sources) if method.condition in FLOWN else None
    frames = scenario.frames * scenario.vehicles
    return FrontEndRun(method, np.vstack(errors), frames, followed, 1e3 * busy_s / frames, outcome)


def _row(seen: Sequence[FrontEndRun], everything: Sequence[FrontEndRun]) -> Row:
    method = seen[0].method
    plain = [other for other in everything if (other.method.name, other.method.condition) == (method.name, EQUAL)]
    errors = np.vstack([flight.errors for flight in seen])
    points = _points_a_frame(seen)
    row: Row = {
        "method": method.name,
        "condition": method.condition,
        "points_per_frame": points,
        "kept_share": ratio(points, _points_a_frame(plain)),
        "followed_share": sum(flight.followed for flight in seen) / max(len(errors), 1),
        "sigma_px": float(errors.std(axis=0).mean()) if len(errors) else None,
        "beyond_1px_share": float(np.mean(np.linalg.norm(errors, axis=1) > BEYOND_PX)) if len(errors) else None,
        "ms_per_frame": mean([flight.ms_per_frame for flight in seen]),
    }
    return row | (_flight_figures(seen) if method.condition in FLOWN else {})


def _points_a_frame(seen: Sequence[FrontEndRun]) -> float:
    return sum(len(flight.errors) for flight in seen) / sum(flight.frames for flight in seen)


def _flight_figures(seen: Sequence[FrontEndRun]) -> Row:
    flown = [flight.outcome for flight in seen if flight.outcome and flight.outcome.figures]
    own, fused = (scores_of(flown, track) for track in ("s_slam", "c_slam"))
    return {
        **pooled_scores(own),
        "c_slam_nees_position": mean(values_of(fused, "nees_position")),
        "c_slam_ratio_to_s_slam": ratio(rms(values_of(fused, "ate_m")), rms(values_of(own, "ate_m"))),
        "failures": len(seen) - len(flown),
        "runs": len(seen),
    }
