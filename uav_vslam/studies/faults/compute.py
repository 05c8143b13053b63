# SPDX-License-Identifier: Apache-2.0
"""Rendered flights whose cameras fail for a while: what the diagnostics report, and how the estimate recovers."""

import dataclasses
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from uav_vslam.config import VehicleConfig
from uav_vslam.evaluation.scores import track_scores
from uav_vslam.evaluation.study import Row
from uav_vslam.evaluation.trajectory import Trajectory
from uav_vslam.offline.track import track_vehicle
from uav_vslam.pipeline import VehicleTrack
from uav_vslam.simulation.faults import FAULTS, FaultySource, end_s
from uav_vslam.simulation.scenario import Scenario, SimulatedVehicle, simulate_vehicle
from uav_vslam.studies.engine.flights import true_trajectory
from uav_vslam.studies.engine.pool import grouped, in_pool
from uav_vslam.studies.engine.score_columns import pooled_scores, values_of

NONE = "none"
BEGIN_SHARE = 0.3  # of the flight
MANY = 20  # associated landmarks count as recovered
NEVER, LASTING = "never", "lasting"

NOTES = {
    "Faults": f"from {100 * BEGIN_SHARE:.0f} % of the flight on, the same on every seed; one vehicle alone",
    "Errors": "root mean squares over the seeds; NEES of the position over 3: mean over the frames after the 20th, and "
    "the worst seed's mean",
    "Reports": "alarms: what the diagnostics reported and for how many frames, summed over the seeds; "
    f"recovered_frames: from the fault's end to the first with {MANY} landmarks, worst seed, {NEVER!r} where one had "
    f"none, {LASTING!r} where the fault has no end",
}


@dataclass(frozen=True, slots=True)
class FaultRun:
    """The result of one flight."""

    method: str
    fault: str
    track: VehicleTrack
    scores: dict[str, Any]
    recovered_frames: int | str


Job = tuple[str, VehicleConfig, Scenario, str, int]


def jobs(scenario: Scenario, configs: Mapping[str, VehicleConfig], seeds: Sequence[int]) -> list[Job]:
    """Return every flight of the study."""
    faults = [NONE, *FAULTS]
    return [
        (name, config, scenario, fault, seed) for name, config in configs.items() for fault in faults for seed in seeds
    ]


def run_study(work: Sequence[Job], *, workers: int, on_flight: Callable[[], None] = lambda: None) -> list[Row]:
    """Fly everything and return the rows of `study.json`."""
    flown = in_pool(fly_fault, work, workers, on_flight)
    return [_row(found) for found in grouped(flown, lambda one: (one.method, one.fault)).values()]


def fly_fault(job: Job) -> FaultRun:
    """Fly one vehicle through a fault."""
    name, config, scenario, fault, seed = job
    scenario = dataclasses.replace(scenario, seed=seed)
    config = dataclasses.replace(config, imu=scenario.imu_config)
    vehicle = simulate_vehicle(scenario, 0)
    begin_s = BEGIN_SHARE * scenario.duration_s
    source = FaultySource(vehicle, fault="" if fault == NONE else fault, begin_s=begin_s)
    track = track_vehicle(source, config)
    scores = track_scores(Trajectory.from_estimates(track.poses), true_trajectory(vehicle))
    end = end_s(source.fault, begin_s, vehicle)
    return FaultRun(name, fault, track, scores, "" if fault == NONE else _recovered_frames(track, vehicle, end))


def _recovered_frames(track: VehicleTrack, vehicle: SimulatedVehicle, end: float) -> int | str:
    """Count the frames from the fault's end to the first with many landmarks; a fault that lasts has no end."""
    if end >= vehicle.scenario.duration_s:
        return LASTING
    later = [out.report for out in track.outputs if vehicle.truth.time_s(out.report.pose.stamp_ns) >= end - 1e-9]
    return next((k for k, report in enumerate(later) if report.associated >= MANY), NEVER)


def _row(flown: Sequence[FaultRun]) -> Row:
    reports = [output.report for one in flown for output in one.track.outputs]
    alarms = Counter(subject for one in flown for subjects in one.track.alarms.values() for subject in subjects)
    scores = [one.scores for one in flown]
    recovered = [one.recovered_frames for one in flown]
    words = [value for value in recovered if isinstance(value, str)]
    return {
        "method": flown[0].method,
        "condition": flown[0].fault,
        "frames": len(reports),
        "frames_coasted": sum(report.coasted for report in reports),
        "alarms": ", ".join(f"{subject} {count}" for subject, count in alarms.items()) or "none",
        "recovered_frames": words[0] if words else max(recovered),
        "runs": len(flown),
        "restarts": sum(report.recovery != "" for report in reports),
        **pooled_scores(scores),
        "nees_position_worst": max(values_of(scores, "nees_position"), default=None),
    }
