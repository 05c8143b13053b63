# SPDX-License-Identifier: Apache-2.0
"""Flights without a start state, and flights with a wrong one, at landmark level."""

import dataclasses
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from uav_vslam.config import StartConfig, VehicleConfig
from uav_vslam.evaluation.consistency import nees
from uav_vslam.evaluation.start_frame import in_start_frame
from uav_vslam.evaluation.study import TABLE, Row
from uav_vslam.evaluation.trajectory import Trajectory
from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.rotation import so3_exp
from uav_vslam.ins.propagation import ROTATION, VELOCITY
from uav_vslam.pipeline import VehiclePipeline, VehicleTrack
from uav_vslam.simulation.landmarks import scatter_landmarks
from uav_vslam.simulation.scenario import Scenario, SimulatedVehicle, simulate_vehicle
from uav_vslam.simulation.source import SimulatedSource
from uav_vslam.studies.engine.flights import true_trajectory
from uav_vslam.studies.engine.pool import in_pool, mean, rms
from uav_vslam.types import NS_PER_S, NavEstimate, NavState

GRADES = ("adis16480", "consumer")
SETTLED_VELOCITY = 0.5  # [m/s]
SETTLED_TILT_DEG = 1.5  # the accelerometer's bias (ADIS16480) alone hides 0.3 degrees per axis until the vehicle turns
SETTLED_WITHIN_S = 5.0
WRONG_FRAMES = 36  # the monitor watches five seconds
NEVER = "never"
SIGMAS = 10  # of which a wrong start is off, in the scenario's own sigmas

NOTES = {
    "settled": f"from then on velocity is within {SETTLED_VELOCITY} m/s and tilt within {SETTLED_TILT_DEG} degrees of "
    f"the truth; within {SETTLED_WITHIN_S:g} s counts; settled_worst_s: {NEVER!r} where one never is",
    "NEES": "of the position in the vehicle's own frame (its first frame defines origin and heading), later than "
    f"{SETTLED_WITHIN_S:g} s after the start",
    "warned": f"the start monitor warned; a wrong start is {SIGMAS} of its sigmas off in one respect",
}


@dataclass(frozen=True, slots=True)
class InFlight:
    """One flight without a start state.

    Attributes:
        velocity_error, tilt_error_deg: of the start that was found, before the filter [m/s], [deg].
        settled_s: see NOTES; infinite if never.
        nees_position: see NOTES; NaN for a flight that ends before.
        end_error_m: in the vehicle's own frame.
    """

    velocity_error: float
    tilt_error_deg: float
    settled_s: float
    nees_position: float
    end_error_m: float


def study_rows(
    grades: Sequence[str], seeds: Sequence[int], *, frames: int, workers: int, on_job: Callable[[], None] = lambda: None
) -> list[Row]:
    """Fly both parts of the study and return their tables."""
    rows: list[Row] = []
    for grade in grades:
        scenarios = [Scenario(seed=seed, frames=frames, vehicles=1, imu=grade) for seed in seeds]
        found = [run for run in in_pool(fly_in_flight, scenarios, workers, on_job) if run]
        labels = {TABLE: "no start state", "method": "in-flight initializer", "condition": grade}
        rows.append(labels | _pooled(found, len(seeds)))
    for what in WRONGS:
        warned = list(in_pool(fly_wrong, [(what, seed) for seed in seeds], workers, on_job))
        labels = {TABLE: "a start state that is wrong", "method": "start monitor", "condition": what}
        rows.append(labels | {"warned": sum(warned), "runs": len(warned)})
    return rows


def fly_in_flight(scenario: Scenario) -> InFlight | None:
    """Fly without a start state; None where no start was found."""
    vehicle = simulate_vehicle(scenario, 0)
    config = VehicleConfig(imu=scenario.imu_config, start=StartConfig(method="in_flight"))
    track = _fly(vehicle, None, config)
    if not track.outputs:
        return None
    first = track.outputs[0].dead_reckoning.state  # the start itself
    times = np.array([output.report.pose.stamp_ns - first.stamp_ns for output in track.outputs]) / NS_PER_S
    errors = np.array([_errors(vehicle, output.report.nav.state) for output in track.outputs])
    bad = np.flatnonzero((errors[:, 0] >= SETTLED_VELOCITY) | (errors[:, 1] >= SETTLED_TILT_DEG))
    settled = 0 if len(bad) == 0 else int(bad[-1]) + 1
    estimate = Trajectory.from_estimates(track.poses)
    truth = in_start_frame(true_trajectory(vehicle), estimate)
    assert truth is not None
    found = nees(estimate, truth)
    assert found is not None
    late = found.position[times > SETTLED_WITHIN_S]
    end = estimate.positions[-1] - truth.positions[np.searchsorted(truth.stamps_ns, estimate.stamps_ns[-1])]
    return InFlight(
        *_errors(vehicle, first),
        settled_s=float(times[settled]) if settled < len(times) else math.inf,
        nees_position=float(late.mean()) if len(late) else math.nan,
        end_error_m=float(np.linalg.norm(end)),
    )


def fly_wrong(job: tuple[str, int]) -> bool:
    """Fly from a start state that is wrong in one respect, and return whether the vehicle warned of it."""
    what, seed = job
    scenario = Scenario(seed=seed, frames=WRONG_FRAMES, vehicles=1)
    vehicle = simulate_vehicle(scenario, 0)
    state, sigma = vehicle.initial.state, np.sqrt(np.diag(vehicle.initial.covariance))
    pose = Pose(so3_exp(WRONGS[what].rotation * sigma[ROTATION]) @ state.T_map_body.R, state.T_map_body.t)
    velocity = state.v_map + WRONGS[what].velocity * sigma[VELOCITY]
    initial = NavEstimate(dataclasses.replace(state, T_map_body=pose, v_map=velocity), vehicle.initial.covariance)
    return len(_fly(vehicle, initial, VehicleConfig(imu=scenario.imu_config)).warnings) > 0


@dataclass(frozen=True, slots=True)
class Wrong:
    """By how many sigmas a start state is off, per axis of the map."""

    velocity: tuple[int, int, int] = (0, 0, 0)
    rotation: tuple[int, int, int] = (0, 0, 0)


WRONGS = {
    "nothing": Wrong(),
    "velocity forward": Wrong(velocity=(SIGMAS, 0, 0)),
    "velocity sideways": Wrong(velocity=(0, SIGMAS, 0)),
    "velocity up": Wrong(velocity=(0, 0, SIGMAS)),
    "velocity in all axes": Wrong(velocity=(SIGMAS, -SIGMAS, SIGMAS)),
    "roll": Wrong(rotation=(SIGMAS, 0, 0)),
    "pitch": Wrong(rotation=(0, SIGMAS, 0)),
    "heading": Wrong(rotation=(0, 0, SIGMAS)),
}


def _fly(vehicle: SimulatedVehicle, initial: NavEstimate | None, config: VehicleConfig) -> VehicleTrack:
    source = SimulatedSource(vehicle, scatter_landmarks([vehicle]))
    pipeline = VehiclePipeline(initial, rig=vehicle.rig, config=config, vehicle=vehicle.name)
    for _ in pipeline.run(source.iter_events()):
        pass
    return pipeline.track


def _errors(vehicle: SimulatedVehicle, state: NavState) -> tuple[float, float]:
    """Return the errors of the velocity in the body [m/s] and of the tilt [deg], whatever the map frame."""
    true = vehicle.true_state(state.stamp_ns)
    R, R_true = state.T_map_body.R, true.T_map_body.R
    velocity = np.linalg.norm(R.T @ state.v_map - R_true.T @ true.v_map)
    return float(velocity), float(np.rad2deg(np.arccos(np.clip(R[2] @ R_true[2], -1.0, 1.0))))


def _pooled(runs: list[InFlight], count: int) -> Row:
    """Return the figures of all flights that found a start."""
    slowest_s = max((run.settled_s for run in runs), default=None)
    return {
        "found": len(runs),
        "runs": count,
        "settled": sum(run.settled_s <= SETTLED_WITHIN_S for run in runs),
        "settled_worst_s": NEVER if slowest_s == math.inf else slowest_s,
        "nees_position": mean([run.nees_position for run in runs if not math.isnan(run.nees_position)]),
        "end_rms_m": rms([run.end_error_m for run in runs]),
        "start_velocity_rms_m_per_s": rms([run.velocity_error for run in runs]),
        "start_tilt_rms_deg": rms([run.tilt_error_deg for run in runs]),
    }
