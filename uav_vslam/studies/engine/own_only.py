# SPDX-License-Identifier: Apache-2.0
"""Studies of one vehicle alone at landmark level: every candidate gets the same flights with the same noise.

The back end is called directly, so that a frame's time is that of prediction, association, update and map alone.
"""

import dataclasses
import functools
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uav_vslam.config import ImuConfig, VehicleConfig, load_vehicle
from uav_vslam.errors import UavVslamError
from uav_vslam.evaluation.trajectory import Trajectory
from uav_vslam.ins.preintegrator import ImuPreintegrator, dead_reckoned
from uav_vslam.simulation.landmarks import PER_FRAME, LandmarkField, LandmarkNoise, observe, scatter_landmarks
from uav_vslam.simulation.scenario import Scenario, SimulatedVehicle, simulate_fleet
from uav_vslam.slam.backend import SlamBackend
from uav_vslam.slam.frame_report import FrameReport
from uav_vslam.studies.engine.flights import true_trajectory
from uav_vslam.studies.engine.pool import in_pool
from uav_vslam.types import ImuIncrement, ImuSample, NavEstimate, StereoFeatures

Array = NDArray[np.float64]
Step = tuple[StereoFeatures, ImuIncrement | None]

INS = "INS"
PAGE_MB = 4096 / 1e6


@dataclass(frozen=True, slots=True)
class Flight:
    """One simulated vehicle's flight, the input of all candidates.

    Attributes:
        vehicle: truth, instruments, start state.
        landmarks: the simulated landmarks.
        noise: quality of the features.
        steps: each frame's features, and the motion to it (None for the first).
        truth, ins: true and dead-reckoned poses at the frames.
    """

    vehicle: SimulatedVehicle
    landmarks: LandmarkField
    noise: LandmarkNoise
    steps: tuple[Step, ...]
    truth: Trajectory
    ins: Trajectory


@dataclass(frozen=True, slots=True)
class Track:
    """A candidate's estimate of a flight, up to where it ended.

    Attributes:
        estimate: poses at the frames.
        failure: why it failed first, whether it was then re-initialised or stopped; empty if it never did.
        restarts: how often the back end was re-initialised.
        frame_ms: (F,) time of this process for each frame [ms]; empty where frames are not processed one by one.
        landmarks: (F,) in the state after each frame.
        resident_mb: (F,) memory of this process after each frame [MB].
    """

    estimate: Trajectory
    failure: str = ""
    restarts: int = 0
    frame_ms: Array = dataclasses.field(default_factory=lambda: np.zeros(0))
    landmarks: NDArray[np.intp] = dataclasses.field(default_factory=lambda: np.zeros(0, np.intp))
    resident_mb: Array = dataclasses.field(default_factory=lambda: np.zeros(0))


@dataclass(frozen=True, slots=True)
class Candidate:
    """A named estimator, from a flight to a track; it can be pickled for worker processes."""

    name: str
    track: Callable[[Flight], Track]


@dataclass(frozen=True, slots=True)
class Trial:
    """Candidates under one condition.

    Attributes:
        condition: label.
        scenario: the flight; the seed is replaced.
        candidates: what to compare.
        noise: quality of the features.
        per_frame: landmarks in view on average.
    """

    condition: str
    scenario: Scenario
    candidates: tuple[Candidate, ...]
    noise: LandmarkNoise = dataclasses.field(default_factory=LandmarkNoise)
    per_frame: float = PER_FRAME


@dataclass(frozen=True, slots=True)
class Run:
    """One candidate on one vehicle's flight of one seed; `truth` and `ins` as in `Flight`."""

    name: str
    condition: str
    seed: int
    vehicle: str
    track: Track
    truth: Trajectory
    ins: Trajectory


def run_trials(
    trials: Sequence[Trial], seeds: Sequence[int], *, workers: int, on_job: Callable[[], None] = lambda: None
) -> list[Run]:
    """Fly every seed of every trial, a job each, and return the runs in the order of trials, seeds, candidates."""
    jobs = [(trial, seed) for trial in trials for seed in seeds]
    return [run for runs in in_pool(run_trial, jobs, workers, on_job) for run in runs]


def run_trial(job: tuple[Trial, int]) -> list[Run]:
    """Fly one seed of a trial: all vehicles of the scenario, each alone, by all candidates."""
    trial, seed = job
    flights = prepare(dataclasses.replace(trial.scenario, seed=seed), trial.noise, per_frame=trial.per_frame)
    return [
        Run(
            candidate.name,
            trial.condition,
            seed,
            flight.vehicle.name,
            candidate.track(flight),
            flight.truth,
            flight.ins,
        )
        for candidate in trial.candidates
        for flight in flights
    ]


def prepare(scenario: Scenario, noise: LandmarkNoise, *, per_frame: float = PER_FRAME) -> list[Flight]:
    """Simulate a scenario and return the flight of each vehicle."""
    vehicles = simulate_fleet(scenario)
    landmarks = scatter_landmarks(vehicles, per_frame=per_frame)
    return [_flight(vehicle, landmarks, noise) for vehicle in vehicles]


def _flight(vehicle: SimulatedVehicle, landmarks: LandmarkField, noise: LandmarkNoise) -> Flight:
    stamps = [int(stamp_ns) for stamp_ns in vehicle.frame_stamps_ns]
    increments, ins = dead_reckon(vehicle.initial, vehicle.scenario.imu_config, vehicle.imu.samples(), stamps)
    features = [seen for seen, _ in observe(vehicle, landmarks, noise=noise)]
    steps = tuple(zip(features, increments, strict=True))
    return Flight(vehicle, landmarks, noise, steps, true_trajectory(vehicle), ins)


def dead_reckon(
    initial: NavEstimate, imu: ImuConfig, samples: Iterable[ImuSample], stamps_ns: Sequence[int]
) -> tuple[list[ImuIncrement | None], Trajectory]:
    """Return the motion to each frame, None for the first, which has the start state; and the INS's poses there."""
    preintegrator = ImuPreintegrator(imu, initial.state)
    increments: list[ImuIncrement | None] = [None]
    estimate, poses = initial, [initial.pose]
    for stamp_ns in stamps_ns[1:]:
        preintegrator.add_frame_stamp(stamp_ns)
    for sample in samples:
        preintegrator.add_imu(sample)
        for increment in preintegrator.increments():  # at once, so that readings are not stored for a whole flight
            increments.append(increment)
            estimate = dead_reckoned(estimate, increment, imu)
            poses.append(estimate.pose)
    return increments, Trajectory.from_estimates(poses)


def dead_reckoning() -> Candidate:
    """The INS alone."""
    return Candidate(INS, _ins_track)


def own_only(name: str, overrides: dict[str, Any]) -> Candidate:
    """The back end with settings that differ from the defaults, as {"backend.sigma_px": 0.5}.

    Raises:
        ConfigError: a key or value is wrong.
    """
    return Candidate(name, functools.partial(run_backend, config=load_vehicle(None, overrides=overrides)))


def _ins_track(flight: Flight) -> Track:
    return Track(flight.ins)


def run_backend(
    flight: Flight, *, config: VehicleConfig, on_report: Callable[[FrameReport], None] = lambda _: None
) -> Track:
    """Feed a flight to a back end of its own; the scenario's IMU replaces `config.imu`."""
    vehicle = flight.vehicle
    config = dataclasses.replace(config, imu=vehicle.scenario.imu_config)
    backend = SlamBackend(vehicle.initial, rig=vehicle.rig, config=config, vehicle=vehicle.name)
    return feed(backend, flight.steps, on_report)


def feed(backend: SlamBackend, steps: Iterable[Step], on_report: Callable[[FrameReport], None]) -> Track:
    """Feed a flight to a back end, frame by frame, until it fails; `on_report` is not timed."""
    poses, landmarks, frame_ms, resident_mb = [], [], [], []
    restarts, failure = 0, ""
    for features, increment in steps:
        started_ns = time.process_time_ns()
        try:
            report = backend.process(features, increment)
        except (UavVslamError, np.linalg.LinAlgError) as error:
            failure = failure or f"{type(error).__name__}: {error}"
            break
        frame_ms.append(1e-6 * (time.process_time_ns() - started_ns))
        resident_mb.append(_resident_mb())
        poses.append(report.pose)
        landmarks.append(report.landmarks)
        restarts += bool(report.recovery)
        failure = failure or report.recovery
        on_report(report)
    return Track(
        Trajectory.from_estimates(poses),
        failure,
        restarts,
        np.array(frame_ms),
        np.array(landmarks, np.intp),
        np.array(resident_mb),
    )


def _resident_mb() -> float:
    """Return the resident memory of this process, from Linux [MB]."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * PAGE_MB
