# SPDX-License-Identifier: Apache-2.0
"""Flies a simulated fleet per seed and method; `flight_rows` pools the figures over seeds and vehicles."""

import dataclasses
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeVar

import numpy as np

from uav_vslam.config import FrontendConfig, RigConfig, VehicleConfig, find_config, load_vehicle
from uav_vslam.errors import UavVslamError
from uav_vslam.evaluation.consistency import Nees, nees
from uav_vslam.evaluation.result import VehicleResult
from uav_vslam.evaluation.summary import TRACKS, build_summary
from uav_vslam.evaluation.trajectory import Trajectory
from uav_vslam.geometry.rotation import quaternion_wxyz_from_rotation
from uav_vslam.offline.flight import fly
from uav_vslam.offline.result import flight_result
from uav_vslam.offline.source import FlightSource
from uav_vslam.offline.track import smooth_track
from uav_vslam.simulation.landmarks import scatter_landmarks
from uav_vslam.simulation.scenario import Scenario, SimulatedVehicle, simulate_fleet
from uav_vslam.simulation.source import SimulatedSource
from uav_vslam.types import StereoFeatures, StereoFrame
from uav_vslam.vision.frontends import make_frontend
from uav_vslam.vision.stereo_points import DetectedPair, StereoFrontend

Found = TypeVar("Found")
Figures = dict[str, dict[str, dict[str, Any]]]  # track -> vehicle -> figures of evaluation.summary
RELIEF_PER_ALTITUDE = 0.03  # as in the default scenario
EXACT = {"backend.redetection_px": 0.0}  # at landmark level, where a landmark is detected alike however long after


@dataclass(frozen=True, slots=True)
class Method:
    """A named configuration under a named condition.

    Attributes:
        name, condition: labels of its rows.
        scenario: the flight; the seed is replaced.
        config: of every vehicle; its `imu` is replaced by the scenario's.
        rendered: images through the front end, else simulated features.
        smoothing: smooth each whole flight afterwards.
    """

    name: str
    condition: str
    scenario: Scenario
    config: VehicleConfig = field(default_factory=VehicleConfig)
    rendered: bool = False
    smoothing: bool = False


@dataclass(frozen=True, slots=True)
class Outcome:
    """One seed of one method.

    Attributes:
        method, seed: which.
        figures: scores by track and vehicle; None where the filter diverged.
        ms_per_frame: processor time after the front end, for a frame of a vehicle [ms].
        processed: share of the frames.
        ms_front_end: processor time of the front end [ms]; NaN without images.
        ms_smoothing: processor time of smoothing, for a frame of a vehicle [ms]; NaN without.
        curves: NEES by track, one of each vehicle.
    """

    method: Method
    seed: int
    figures: Figures | None
    ms_per_frame: float
    processed: float = 0.0
    ms_front_end: float = float("nan")
    ms_smoothing: float = float("nan")
    curves: Mapping[str, Sequence[Nees]] = field(default_factory=dict, compare=False)


@dataclass(frozen=True, slots=True)
class FeatureCache:
    """Features found by front ends, so that images are rendered and searched only once.

    Attributes:
        searched: keypoints of a vehicle, by its name, images and front end; they don't depend on the rig's uncertainty.
        followed: tracked points of a vehicle, by its name, images, front end and rig uncertainty.

    Beside each is the processor time of a frame [ms].
    """

    searched: dict[tuple[str, Scenario, FrontendConfig], tuple[tuple[DetectedPair, ...], float]] = field(
        default_factory=dict
    )
    followed: dict[tuple[str, Scenario, FrontendConfig, RigConfig], tuple[tuple[StereoFeatures, ...], float]] = field(
        default_factory=dict
    )


def run_seed(methods: list[Method], seed: int) -> list[Outcome]:
    """Fly all methods on one seed; images are rendered and searched for features only once for all of them."""
    cache = FeatureCache()
    return [_run(method, seed, cache) for method in methods]


def _run(method: Method, seed: int, cache: FeatureCache) -> Outcome:
    scenario = dataclasses.replace(method.scenario, seed=seed)
    vehicles = simulate_fleet(scenario)
    sources, ms_front_end = _sources(method, scenario, vehicles, cache)
    outcome = fly_sources(method, scenario, vehicles, sources)
    return dataclasses.replace(outcome, ms_front_end=ms_front_end)


def fly_sources(
    method: Method, scenario: Scenario, vehicles: list[SimulatedVehicle], sources: list[FlightSource]
) -> Outcome:
    """Fly one seed's vehicles with the features of their sources."""
    seed = scenario.seed
    config = dataclasses.replace(method.config, imu=scenario.imu_config)
    configs = {vehicle.name: config for vehicle in vehicles}
    started = time.process_time()
    try:
        tracks, fleet = fly(sources, configs, keep_features=method.smoothing)
    except UavVslamError:
        return Outcome(method, seed, None, float("nan"))
    ms = _ms_since(started, scenario.frames * scenario.vehicles)
    ms_smoothing = float("nan")
    if method.smoothing:
        started = time.process_time()
        for source in sources:
            smooth_track(tracks[source.vehicle], source.rig, config)
        ms_smoothing = _ms_since(started, scenario.frames * scenario.vehicles)
    truths: dict[str, Trajectory | None] = {vehicle.name: true_trajectory(vehicle) for vehicle in vehicles}
    result = flight_result(scenario.name, tracks, fleet, truths, configs, seed=seed)
    reports = build_summary(result, git=None)["vehicles"]
    figures = {track: {name: report[track] for name, report in reports.items() if report[track]} for track in TRACKS}
    processed = [report["frames_processed"] / report["frames_in"] for report in reports.values()]
    curves = {
        track: [curve for vehicle in result.vehicles.values() if (curve := _nees(vehicle, track))]
        for track in TRACKS[1:]
    }
    return Outcome(method, seed, figures, ms, float(np.mean(processed)), ms_smoothing=ms_smoothing, curves=curves)


def _nees(vehicle: VehicleResult, track: str) -> Nees | None:
    """Return the NEES of a track; None without the track."""
    estimate = getattr(vehicle, track)
    return None if estimate is None or vehicle.truth is None else nees(estimate, vehicle.truth)


def _sources(
    method: Method, scenario: Scenario, vehicles: list[SimulatedVehicle], cache: FeatureCache
) -> tuple[list[FlightSource], float]:
    """Return each vehicle's data, and the front end's processor time for a frame [ms]."""
    if not method.rendered:
        landmarks = scatter_landmarks(vehicles)
        return [SimulatedSource(vehicle, landmarks) for vehicle in vehicles], float("nan")
    images = dataclasses.replace(scenario, imu="adis16480")  # the images don't depend on the inertial unit
    extract = _matched if method.config.frontend.method == "sift" else _followed
    found = [extract(vehicle, images, method.config, cache) for vehicle in vehicles]
    return [source for source, _ in found], float(np.mean([ms for _, ms in found]))


def _ms_since(started: float, frames: int) -> float:
    return 1e3 * (time.process_time() - started) / frames


def _followed(
    vehicle: SimulatedVehicle, images: Scenario, config: VehicleConfig, cache: FeatureCache
) -> tuple[SimulatedSource, float]:
    """Track points through a flight; later detections depend on which points the rig's gates accepted before."""
    key = (vehicle.name, images, config.frontend, config.rig)
    if key not in cache.followed:
        frontend = make_frontend(vehicle.rig, config.frontend, config.rig)
        cache.followed[key] = _timed(frontend.process, SimulatedSource(vehicle))
    features, ms = cache.followed[key]
    return SimulatedSource(vehicle, features=features), ms


def _matched(
    vehicle: SimulatedVehicle, images: Scenario, config: VehicleConfig, cache: FeatureCache
) -> tuple[SimulatedSource, float]:
    """Match the detected keypoints; unlike detection, this depends on the rig's uncertainty."""
    frontend = StereoFrontend(vehicle.rig, config.frontend, config.rig)
    key = (vehicle.name, images, config.frontend)
    if key not in cache.searched:
        cache.searched[key] = _timed(frontend.detect, SimulatedSource(vehicle))
    pairs, ms = cache.searched[key]
    started = time.process_time()
    features = tuple(map(frontend.match, pairs))
    return SimulatedSource(vehicle, features=features), ms + _ms_since(started, len(pairs))


def _timed(process: Callable[[StereoFrame], Found], source: SimulatedSource) -> tuple[tuple[Found, ...], float]:
    """Return what is found in each rendered pair, and the mean time for one without its rendering [ms]."""
    found: list[Found] = []
    busy_s = 0.0
    for frame in source.frames():
        assert isinstance(frame, StereoFrame)
        started = time.process_time()
        found.append(process(frame))
        busy_s += time.process_time() - started
    return tuple(found), 1e3 * busy_s / max(len(found), 1)


def true_trajectory(vehicle: SimulatedVehicle) -> Trajectory:
    """Return the true poses at a simulated vehicle's frames."""
    times = vehicle.frame_times_s
    return Trajectory(
        vehicle.frame_stamps_ns,
        vehicle.truth.position(times),
        quaternion_wxyz_from_rotation(vehicle.truth.rotation(times)),
    )


def kagaru_configs(variants: Mapping[str, dict[str, object]]) -> dict[str, VehicleConfig]:
    """Return the configuration of rendered flights with each of the overrides, by their names.

    Raises:
        ConfigError: a key or value is wrong.
    """
    return {name: load_vehicle(find_config("kagaru"), overrides=keys) for name, keys in variants.items()}


def exact_config() -> VehicleConfig:
    """Return the configuration of flights at landmark level."""
    return load_vehicle(None, overrides=EXACT)


def with_backend(config: VehicleConfig, **changes: Any) -> VehicleConfig:
    """Return a configuration with other backend settings."""
    return dataclasses.replace(config, backend=dataclasses.replace(config.backend, **changes))
