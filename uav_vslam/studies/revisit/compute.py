# SPDX-License-Identifier: Apache-2.0
"""Flights that return to their start after 2 km: retained landmarks correct the drift; without them it stays."""

import dataclasses
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uav_vslam.config import VehicleConfig, find_config, load_vehicle
from uav_vslam.simulation.camera_render import RenderedFlight
from uav_vslam.simulation.landmarks import LandmarkField, LandmarkNoise, observe, scatter_landmarks
from uav_vslam.simulation.scenario import SCENARIOS, Scenario, SimulatedVehicle, simulate_vehicle
from uav_vslam.simulation.terrain import relief_of
from uav_vslam.slam.frame_report import FrameReport
from uav_vslam.slam.landmark_map import LONG_FRAMES
from uav_vslam.studies.engine.extracted_flights import ground_points
from uav_vslam.studies.engine.flights import EXACT, true_trajectory
from uav_vslam.studies.engine.own_only import Flight, Run, dead_reckon, run_backend
from uav_vslam.studies.engine.pool import in_pool
from uav_vslam.types import StereoFeatures
from uav_vslam.vision.frontends import make_frontend

Array = NDArray[np.float64]

LANDMARK, RENDERED = "landmark", "rendered"
FORGETTING = "nothing retained"
NOISE = LandmarkNoise(missed_share=0.3, lookalike_share=0.05)
PER_FRAME = 60.0  # landmarks in view, of which some are missed
TWIN_SHARE = 0.2
FALSE_BEYOND_M = 0.3  # seven pixels: a point farther from the landmark's first position is another point


@dataclass(frozen=True, slots=True)
class Loop:
    """One flight by one method.

    Attributes:
        level: landmark or rendered.
        run: its track.
        false: (C,) which of the landmarks re-observed after a long time were another point.
    """

    level: str
    run: Run
    false: NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Job:
    """One flight by all methods, with their configurations by name."""

    level: str
    scenario: Scenario
    configs: Mapping[str, VehicleConfig]


class RevisitChecker:
    """Records each landmark's true identity at its first observation, and the frame of its last.

    Attributes:
        false: which of the landmarks re-observed after a long time were another point.
    """

    def __init__(self, truth: Sequence[Array]) -> None:
        """Prepare for a flight.

        Args:
            truth: (N, 4) of each frame's features: identity of the landmark, -1 where there is none, and the point of
                the ground that it shows [m].
        """
        self._truth, self._frame = truth, 0
        self._first: dict[int, Array] = {}
        self._last: dict[int, int] = {}
        self.false: list[bool] = []

    def add(self, report: FrameReport) -> None:
        """Process the report of the next frame."""
        shown = self._truth[self._frame]
        for landmark, feature in report.sightings.tolist():
            first = self._first.setdefault(landmark, shown[feature])
            if self._frame - self._last.get(landmark, self._frame) >= LONG_FRAMES:
                self.false.append(_differ(first, shown[feature]))
            self._last[landmark] = self._frame
        self._frame += 1


def _differ(first: Array, now: Array) -> bool:
    """Return whether two observations are of different points: by identity, or else by position."""
    if min(first[0], now[0]) >= 0:
        return bool(first[0] != now[0])
    return bool(np.linalg.norm(now[1:] - first[1:]) > FALSE_BEYOND_M)


def revisit_jobs(
    variants: Mapping[str, Mapping[str, Any]],
    seeds: Sequence[int],
    rendered: Sequence[int],
    *,
    frames: int | None,
) -> list[Job]:
    """Return a job for each seed at landmark level, and for each that is rendered.

    Args:
        variants: settings to compare, by name; the defaults where there are none. Those without retention come last.
        seeds: at landmark level.
        rendered: seeds with images.
        frames: of each flight, where not the whole one is wanted.

    Raises:
        ConfigError: a key or value is wrong.
    """
    scenario = SCENARIOS["revisit"]
    scenario = dataclasses.replace(scenario, frames=frames or scenario.frames)
    methods = {**(variants or {"retained": {}}), FORGETTING: {"backend.retention": "none"}}
    jobs = []
    for level, level_seeds in ((LANDMARK, seeds), (RENDERED, rendered)):
        file, exact = (find_config("kagaru"), {}) if level == RENDERED else (None, EXACT)
        configs = {name: load_vehicle(file, overrides=exact | dict(keys)) for name, keys in methods.items()}
        jobs += [Job(level, dataclasses.replace(scenario, seed=seed), configs) for seed in level_seeds]
    return jobs


def revisit_loops(jobs: Sequence[Job], *, workers: int, on_frame: Callable[[], None]) -> list[Loop]:
    """Fly all jobs; progress is reported frame by frame in a single process, job by job otherwise."""
    if workers == 1:
        return [loop for job in jobs for loop in fly_loop(job, on_frame)]
    loops: list[Loop] = []
    for found in in_pool(fly_loop, jobs, workers):
        loops += found
        for _ in found[0].run.truth.stamps_ns:
            on_frame()
    return loops


def fly_loop(job: Job, on_frame: Callable[[], None] = lambda: None) -> list[Loop]:
    """Fly one scenario: extract each frame's features once, then run each method's back end on them."""
    flight, truth = _prepare(job, on_frame)
    loops = []
    for name, config in job.configs.items():
        checker = RevisitChecker(truth)
        track = run_backend(flight, config=config, on_report=checker.add)
        run = Run(name, job.level, job.scenario.seed, flight.vehicle.name, track, flight.truth, flight.ins)
        loops.append(Loop(job.level, run, np.array(checker.false, bool)))
    return loops


def _prepare(job: Job, on_frame: Callable[[], None]) -> tuple[Flight, list[Array]]:
    """Return a flight, and the truth of each frame's features in the form of `RevisitChecker`."""
    vehicle, relief = simulate_vehicle(job.scenario, 0), relief_of(job.scenario)
    landmarks = scatter_landmarks([vehicle], per_frame=PER_FRAME, twin_share=TWIN_SHARE)
    seen, truth = [], []
    for frame, (features, identities) in enumerate(_features(job, vehicle, landmarks)):
        seen.append(features)
        T_world_left = vehicle.truth.pose(float(vehicle.frame_times_s[frame])) @ vehicle.rig.T_body_left
        points = ground_points(relief, T_world_left, vehicle.rig.left, features.pixels[:, :2])
        truth.append(np.column_stack([identities, points]))
        on_frame()
    stamps = [features.stamp_ns for features in seen]
    increments, ins = dead_reckon(vehicle.initial, job.scenario.imu_config, vehicle.imu.samples(), stamps)
    steps = tuple(zip(seen, increments, strict=True))
    return Flight(vehicle, landmarks, NOISE, steps, true_trajectory(vehicle), ins), truth


def _features(
    job: Job, vehicle: SimulatedVehicle, landmarks: LandmarkField
) -> Iterator[tuple[StereoFeatures, NDArray[np.int64]]]:
    """Yield each frame's features and their identities; images are rendered one by one and not stored."""
    if job.level == LANDMARK:
        yield from observe(vehicle, landmarks, noise=NOISE)
        return
    config = next(iter(job.configs.values()))
    frontend = make_frontend(vehicle.rig, config.frontend, config.rig)
    for images in RenderedFlight(vehicle):
        features = frontend.process(images)
        yield features, np.full(len(features), -1)
