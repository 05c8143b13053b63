# SPDX-License-Identifier: Apache-2.0
"""Flies a simulated fleet per seed and method, and pools the figures over seeds and vehicles."""

import dataclasses
import functools
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uav_vslam.config import FrontendConfig, RigConfig, VehicleConfig, find_config, load_vehicle
from uav_vslam.errors import UavVslamError
from uav_vslam.evaluation.summary import build_summary
from uav_vslam.evaluation.trajectory import Trajectory
from uav_vslam.geometry.rotation import quaternion_wxyz_from_rotation
from uav_vslam.geometry.stereo import StereoRig
from uav_vslam.offline import FlightSource, flight_result, fly
from uav_vslam.simulation.landmarks import scatter_landmarks
from uav_vslam.simulation.scenario import Scenario, SimulatedVehicle, simulate_fleet
from uav_vslam.simulation.source import SimulatedSource
from uav_vslam.studies.engine.pool import in_pool, mean, mean_interval, ratio, ratio_interval, rms
from uav_vslam.types import StereoFeatures, StereoFrame
from uav_vslam.vision.frontends import make_frontend
from uav_vslam.vision.stereo_points import DetectedPair, StereoFrontend

Figures = dict[str, dict[str, dict[str, Any]]]  # track -> vehicle -> figures of evaluation.summary
LABELS = {"ins": "INS", "s_slam": "S-SLAM", "c_slam": "C-SLAM"}
TRACKS = tuple(LABELS)
RELIEF_PER_ALTITUDE = 0.03  # as in the default scenario


@dataclass(frozen=True, slots=True)
class Method:
    """A named configuration under a named condition.

    Attributes:
        name, condition: labels of its rows.
        scenario: the flight; the seed is replaced.
        config: of every vehicle; its `imu` is replaced by the scenario's.
        rendered: images through the front end, else simulated features.
    """

    name: str
    condition: str
    scenario: Scenario
    config: VehicleConfig = field(default_factory=VehicleConfig)
    rendered: bool = False


@dataclass(frozen=True, slots=True)
class Outcome:
    """One seed of one method; `figures` is None where the filter diverged, `processed` the share of frames."""

    method: Method
    seed: int
    figures: Figures | None
    ms_per_frame: float
    processed: float = 0.0


@dataclass(frozen=True, slots=True)
class FeatureCache:
    """Features found by front ends, so that images are rendered and searched only once.

    Attributes:
        searched: keypoints of the whole fleet, by images and front end; they don't depend on the rig's uncertainty.
        followed: tracked points of a vehicle, by its name, images, front end and rig uncertainty.
    """

    searched: dict[tuple[Scenario, FrontendConfig], list[tuple[DetectedPair, ...]]] = field(default_factory=dict)
    followed: dict[tuple[str, Scenario, FrontendConfig, RigConfig], tuple[StereoFeatures, ...]] = field(
        default_factory=dict
    )


def run_seed(methods: list[Method], seed: int) -> list[Outcome]:
    """Fly all methods on one seed; images are rendered and searched for features only once for all of them."""
    cache = FeatureCache()
    return [_run(method, seed, cache) for method in methods]


def run_study(
    methods: list[Method], seeds: list[int], *, workers: int, on_seed: Callable[[], None] = lambda: None
) -> list[dict[str, Any]]:
    """Fly every method on every seed and return the rows of `study.json`.

    Args:
        methods: what to compare.
        seeds: of the flights; every method flies the same ones.
        workers: processes.
        on_seed: called when a seed is done.
    """
    flown = in_pool(functools.partial(run_seed, methods), seeds, workers, on_seed)
    outcomes = sorted((outcome for found in flown for outcome in found), key=lambda outcome: outcome.seed)
    rows = []
    for number, method in enumerate(methods):
        first = method.condition not in {earlier.condition for earlier in methods[:number]}
        tracks = TRACKS if first else TRACKS[1:]  # the INS is the same whatever the method
        rows += _rows(method, [o for o in outcomes if o.method == method], tracks)
    return rows


def _run(method: Method, seed: int, cache: FeatureCache) -> Outcome:
    scenario = dataclasses.replace(method.scenario, seed=seed)
    vehicles = simulate_fleet(scenario)
    return fly_sources(method, scenario, vehicles, _sources(method, scenario, vehicles, cache))


def fly_sources(
    method: Method, scenario: Scenario, vehicles: list[SimulatedVehicle], sources: list[FlightSource]
) -> Outcome:
    """Fly one seed's vehicles with the features of their sources."""
    seed = scenario.seed
    config = dataclasses.replace(method.config, imu=scenario.imu_config)
    configs = {vehicle.name: config for vehicle in vehicles}
    started = time.process_time()
    try:
        tracks, fleet = fly(sources, configs)
    except UavVslamError:
        return Outcome(method, seed, None, float("nan"))
    ms = 1e3 * (time.process_time() - started) / (scenario.frames * scenario.vehicles)
    truths: dict[str, Trajectory | None] = {vehicle.name: true_trajectory(vehicle) for vehicle in vehicles}
    summary = build_summary(flight_result(scenario.name, tracks, fleet, truths, configs, seed=seed), git=None)
    reports = summary["vehicles"]
    figures = {track: {name: report[track] for name, report in reports.items() if report[track]} for track in TRACKS}
    processed = [report["frames_processed"] / report["frames_in"] for report in reports.values()]
    return Outcome(method, seed, figures, ms, float(np.mean(processed)))


def _sources(
    method: Method, scenario: Scenario, vehicles: list[SimulatedVehicle], cache: FeatureCache
) -> list[FlightSource]:
    if not method.rendered:
        landmarks = scatter_landmarks(vehicles)
        return [SimulatedSource(vehicle, landmarks) for vehicle in vehicles]
    images = dataclasses.replace(scenario, imu="adis16480")  # the images don't depend on the inertial unit
    if method.config.frontend.method != "sift":
        return [_followed(vehicle, images, method.config, cache) for vehicle in vehicles]
    key = (images, method.config.frontend)
    if key not in cache.searched:
        cache.searched[key] = [_searched(SimulatedSource(vehicle), method.config) for vehicle in vehicles]
    return [
        SimulatedSource(vehicle, features=_matched(vehicle.rig, pairs, method.config))
        for vehicle, pairs in zip(vehicles, cache.searched[key], strict=True)
    ]


def _followed(
    vehicle: SimulatedVehicle, images: Scenario, config: VehicleConfig, cache: FeatureCache
) -> SimulatedSource:
    """Track points through a flight; later detections depend on which points the rig's gates accepted before."""
    key = (vehicle.name, images, config.frontend, config.rig)
    if key not in cache.followed:
        frontend = make_frontend(vehicle.rig, config.frontend, config.rig)
        frames = SimulatedSource(vehicle).frames()
        cache.followed[key] = tuple(frontend.process(frame) for frame in frames if isinstance(frame, StereoFrame))
    return SimulatedSource(vehicle, features=cache.followed[key])


def _searched(source: SimulatedSource, config: VehicleConfig) -> tuple[DetectedPair, ...]:
    frontend = StereoFrontend(source.rig, config.frontend, config.rig)
    return tuple(frontend.detect(frame) for frame in source.frames() if isinstance(frame, StereoFrame))


def _matched(rig: StereoRig, pairs: Sequence[DetectedPair], config: VehicleConfig) -> tuple[StereoFeatures, ...]:
    """Match the detected keypoints; unlike detection, this depends on the rig's uncertainty."""
    frontend = StereoFrontend(rig, config.frontend, config.rig)
    return tuple(frontend.match(pair) for pair in pairs)


def true_trajectory(vehicle: SimulatedVehicle) -> Trajectory:
    """Return the true poses at a simulated vehicle's frames."""
    times = vehicle.frame_times_s
    return Trajectory(
        vehicle.frame_stamps_ns,
        vehicle.truth.position(times),
        quaternion_wxyz_from_rotation(vehicle.truth.rotation(times)),
    )


def _rows(method: Method, outcomes: list[Outcome], tracks: Sequence[str]) -> list[dict[str, Any]]:
    """Return one row per track; the INS's covariance is not scored."""
    good = [outcome for outcome in outcomes if outcome.figures]
    errors = {(track, key): rms(_values(good, track, key)) for track in TRACKS for key in ("ate_m", "end_m")}
    return [
        {
            "method": LABELS[track] if track == "ins" else f"{LABELS[track]} {method.name}",
            "condition": method.condition,
            "end_rms_m": errors[track, "end_m"],
            "ate_rms_m": errors[track, "ate_m"],
            "ratio_to_s_slam": ratio(errors[track, "ate_m"], errors["s_slam", "ate_m"]),
            **ratio_interval(_of_seeds(good, "s_slam", "ate_m") ** 2, _of_seeds(good, track, "ate_m") ** 2),
            "end_ratio_to_ins": ratio(errors[track, "end_m"], errors["ins", "end_m"]),
            "nees_position": mean(_values(good, track, "nees_position")),
            **mean_interval("nees_position", _of_seeds(good, track, "nees_position", mean)),
            "processed_share": mean([outcome.processed for outcome in good]),
            "failures": len(outcomes) - len(good),
            "runs": len(outcomes),
            "ms_per_frame": None if track == "ins" else mean([outcome.ms_per_frame for outcome in good]),
        }
        for track in tracks
    ]


def _values(outcomes: list[Outcome], track: str, key: str) -> list[float]:
    found = [v.get(key) for o in outcomes for v in (o.figures or {}).get(track, {}).values()]
    return [float(value) for value in found if value is not None]


def _of_seeds(
    outcomes: list[Outcome], track: str, key: str, pool: Callable[[Sequence[float]], float | None] = rms
) -> NDArray[np.float64]:
    """Return (S,) figures of each seed, pooled over its vehicles; NaN where there are none."""
    return np.array([pool(_values([outcome], track, key)) for outcome in outcomes], dtype=np.float64)


def kagaru_configs(variants: Mapping[str, dict[str, object]]) -> dict[str, VehicleConfig]:
    """Return the configuration of rendered flights with each of the overrides, by their names.

    Raises:
        ConfigError: a key or value is wrong.
    """
    return {name: load_vehicle(find_config("kagaru"), overrides=keys) for name, keys in variants.items()}


def with_backend(config: VehicleConfig, **changes: Any) -> VehicleConfig:
    """Return a configuration with other backend settings."""
    return dataclasses.replace(config, backend=dataclasses.replace(config.backend, **changes))
