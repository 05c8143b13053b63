# SPDX-License-Identifier: Apache-2.0
"""One vehicle maps the ground; two others, without a start state, fly over it in that map, alone and together."""

import dataclasses
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uav_vslam.config import FusionConfig, StartConfig, VehicleConfig, find_config, load_vehicle
from uav_vslam.errors import UavVslamError
from uav_vslam.evaluation.study import TABLE, Row
from uav_vslam.evaluation.trajectory import Trajectory
from uav_vslam.fleet import cooperate
from uav_vslam.geometry.pose import Pose
from uav_vslam.offline.track import track_vehicle
from uav_vslam.pipeline import VehicleTrack
from uav_vslam.simulation.landmarks import scatter_landmarks
from uav_vslam.simulation.scenario import SCENARIOS, SimulatedVehicle, simulate_fleet
from uav_vslam.simulation.source import SimulatedSource
from uav_vslam.slam.saved_map import save_map
from uav_vslam.studies.engine.flights import exact_config, true_trajectory
from uav_vslam.studies.engine.pool import in_pool, mean, mean_interval, median, rms
from uav_vslam.studies.engine.scores import errors_and_nees
from uav_vslam.studies.engine.separate_frames import with_joints
from uav_vslam.types import NS_PER_S, PoseEstimate

Array = NDArray[np.float64]

SIGMA_START_M = 2.0  # of the mapping flight's start, per axis: the error that all flights in the map share
SETTLED_M, SETTLED_WITHIN_S = 1.0, 5.0
DEFAULT_IMU = "adis16480"
ALONE, WITH_MAP = "alone", "with the map"

NOTES = {
    "flights": f"uav1 maps, from a start known to {SIGMA_START_M:g} m per axis; uav2 and uav3 fly 17 and 34 m beside "
    "it, without a start state",
    "settled": f"{SETTLED_WITHIN_S:g} s after its first frame the vehicle knows to {SETTLED_M:g} m where it is in the "
    "map: the error of the mapping flight's own pose at the nearest place is left out of this figure",
    "settled_to_start": "as `settled`, but only the shift of the map's start is left out, not its heading or drift",
    "error": "error_median_m: at the start, in the map; found_s: from the first frame to the start, mean",
    "declared": "packets name the map's hash and its measurements, as they do by default; 'not declared' strips both",
    "with the map": "the loaded map is fused at each epoch; alone: own-only",
}


@dataclass(frozen=True, slots=True)
class Together:
    """How two vehicles in one map are fused.

    Attributes:
        name: of the row.
        fusion: settings that differ from the defaults.
        declared: their beliefs name the map.
        loaded: the map itself is fused too.
    """

    name: str
    fusion: Mapping[str, Any]
    declared: bool = True
    loaded: bool = True


SETTINGS = (
    Together(WITH_MAP, {"mode": "none"}),
    Together("together, split_ci", {}),
    Together("together, split_ci, without the map's landmarks", {}, loaded=False),
    Together("together, split_ci, map not declared", {}, declared=False),
    Together("together, plain sum", {"scheme": "overlay"}),
)


@dataclass(frozen=True, slots=True)
class Flight:
    """One vehicle of one seed: its errors over time under each setting.

    Attributes:
        found_s: from its first frame to the first that was processed; None without a start.
        start_error_m: of the start, in the map.
        settled, settled_to_start: see NOTES.
        errors_m, nees: (F,) by setting.
    """

    found_s: float | None
    start_error_m: float = float("nan")
    settled: bool = False
    settled_to_start: bool = False
    errors_m: Mapping[str, Array] = dataclasses.field(default_factory=dict)
    nees: Mapping[str, Array] = dataclasses.field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Job:
    """One seed: at landmark level or over rendered ground, grade of the inertial unit, whether the map is smoothed."""

    seed: int
    frames: int
    imu: str = DEFAULT_IMU
    rendered: bool = False
    smoothing: bool = True


def study_rows(
    seeds: Sequence[int],
    rendered: Sequence[int],
    *,
    frames: int,
    workers: int,
    imu: str = DEFAULT_IMU,
    smoothing: bool = True,
    on_job: Callable[[], None] = lambda: None,
) -> list[Row]:
    """Fly all seeds and return the table."""
    rows: list[Row] = []
    for level, flown, images in (("landmark level, 1 px", seeds, False), ("rendered images, 480x360", rendered, True)):
        jobs = [Job(seed, frames, imu, images, smoothing) for seed in flown]
        runs = list(in_pool(run_seed, jobs, workers, on_job))
        rows += _rows(f"{level}, {imu}", runs) if runs else []
    return rows


def run_seed(job: Job) -> list[Flight]:
    """Map the ground, then fly uav2 and uav3 in the map."""
    base = SCENARIOS["sample" if job.rendered else "kagaru"]
    scenario = dataclasses.replace(
        base, seed=job.seed, frames=job.frames, vehicles=3, imu=job.imu, sigma_position_m=SIGMA_START_M
    )
    config = load_vehicle(find_config("sample")) if job.rendered else exact_config()
    config = dataclasses.replace(config, imu=scenario.imu_config)
    vehicles = simulate_fleet(scenario)
    landmarks = None if job.rendered else scatter_landmarks(vehicles)
    sources = [SimulatedSource(vehicle, landmarks) for vehicle in vehicles]
    mapping = track_vehicle(sources[0], config, keep_map=True, smoothing=job.smoothing)
    assert mapping.saved_map is not None
    assert bool(mapping.smoothed) == job.smoothing, mapping.warnings
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "map.npz"
        save_map(mapping.saved_map, path)
        in_map = dataclasses.replace(config, start=StartConfig(method="map", map=str(path)))
        tracks = {source.vehicle: track for source in sources[1:] if (track := _fly(source, in_map)) is not None}
        estimates = {setting.name: _fused(tracks, in_map, setting) for setting in SETTINGS} if tracks else {}
    estimates[ALONE] = {name: track.poses for name, track in tracks.items()}
    errors = MapErrors.of(vehicles[0], mapping)
    return [_flight(vehicle, tracks.get(vehicle.name), estimates, errors) for vehicle in vehicles[1:]]


def _fly(source: SimulatedSource, config: VehicleConfig) -> VehicleTrack | None:
    try:
        return track_vehicle(source, config)
    except UavVslamError:
        return None


def _fused(tracks: dict[str, VehicleTrack], config: VehicleConfig, setting: Together) -> dict[str, list[Any]]:
    """Return each vehicle's fused poses."""
    fusion = dataclasses.replace(FusionConfig(), **setting.fusion)
    start = config.start if setting.loaded else dataclasses.replace(config.start, map="")
    configs = {name: dataclasses.replace(config, fusion=fusion, start=start) for name in tracks}
    declared = tracks if setting.declared else {name: _undeclared(track) for name, track in tracks.items()}
    return {name: member.poses for name, member in cooperate(declared, configs).items()}


def _undeclared(track: VehicleTrack) -> VehicleTrack:
    """Return a track whose beliefs do not name the map that they depend on."""
    return with_joints(track, lambda joint: dataclasses.replace(joint, prior_id="", other_sources=()))


@dataclass(frozen=True, slots=True)
class MapErrors:
    """Where the mapping flight believed to be, and was.

    Attributes:
        estimated, true: T_map_body of each of its frames.
    """

    estimated: Sequence[Pose]
    true: Sequence[Pose]

    @staticmethod
    def of(vehicle: SimulatedVehicle, track: VehicleTrack) -> "MapErrors":
        """Return those of a track."""
        poses = track.smoothed or track.poses
        return MapErrors(
            [pose.T_map_body for pose in poses], [vehicle.true_state(pose.stamp_ns).T_map_body for pose in poses]
        )

    @property
    def of_start_m(self) -> Array:
        """(3,) shift of its start, and so of the whole map."""
        return np.asarray(self.estimated[0].t - self.true[0].t)

    def in_map(self, T_true: Pose) -> Array:
        """Return where a vehicle is in the map (3,), going by the mapping flight's pose at the nearest place [m]."""
        k = int(np.argmin([np.linalg.norm(T.t[:2] - T_true.t[:2]) for T in self.true]))
        return np.asarray((self.estimated[k] @ self.true[k].inverse()).apply(T_true.t))


def _flight(
    vehicle: SimulatedVehicle, track: VehicleTrack | None, estimates: Mapping[str, Any], errors: MapErrors
) -> Flight:
    if track is None or track.start is None:
        return Flight(None)
    truth = true_trajectory(vehicle)
    errors_m, values = {}, {}
    for name, poses in estimates.items():
        errors_m[name], values[name] = errors_and_nees(Trajectory.from_estimates(poses[vehicle.name]), truth)
    start, first_ns = track.start.pose, int(vehicle.frame_stamps_ns[0])
    by_then = [
        pose for pose in estimates[WITH_MAP][vehicle.name] if pose.stamp_ns - first_ns <= SETTLED_WITHIN_S * NS_PER_S
    ]
    in_map_m = [_error_m(vehicle, pose, errors.in_map) for pose in by_then[-1:]]
    to_start_m = [_error_m(vehicle, pose, lambda T: T.t + errors.of_start_m) for pose in by_then[-1:]]
    return Flight(
        found_s=(start.stamp_ns - first_ns) / NS_PER_S,
        start_error_m=_error_m(vehicle, start, errors.in_map),
        settled=min(in_map_m, default=np.inf) < SETTLED_M,
        settled_to_start=min(to_start_m, default=np.inf) < SETTLED_M,
        errors_m=errors_m,
        nees=values,
    )


def _error_m(vehicle: SimulatedVehicle, pose: PoseEstimate, expected: Callable[[Pose], Array]) -> float:
    """Return the distance of a pose to where it is expected, given the true pose."""
    return float(np.linalg.norm(pose.T_map_body.t - expected(vehicle.true_state(pose.stamp_ns).T_map_body)))


def _rows(condition: str, runs: list[list[Flight]]) -> list[Row]:
    """Return the table of all seeds' flights."""
    flights = [flight for run in runs for flight in run]
    found = [flight for flight in flights if flight.found_s is not None]
    rows: list[Row] = [
        {
            TABLE: "the start in the map",
            "method": "map",
            "condition": condition,
            "found": len(found),
            "settled": sum(flight.settled for flight in found),
            "settled_to_start": sum(flight.settled_to_start for flight in found),
            "runs": len(flights),
            "found_s": mean([flight.found_s for flight in found if flight.found_s is not None]),
            "error_median_m": median([flight.start_error_m for flight in found]),
            "error_worst_m": max((flight.start_error_m for flight in found), default=None),
        }
    ]
    names = (ALONE, *(setting.name for setting in SETTINGS))
    return rows + [_row(name, condition, runs) for name in names]


def _row(name: str, condition: str, runs: list[list[Flight]]) -> Row:
    of_seeds = [[flight for flight in run if name in flight.nees] for run in runs]
    flights = [flight for run in of_seeds for flight in run]
    values = np.array([np.mean([flight.nees[name].mean() for flight in run]) for run in of_seeds if run])
    return {
        TABLE: "the flight in the map",
        "method": name,
        "condition": condition,
        "runs": len(flights),
        "ate_rms_m": rms([float(np.sqrt(np.mean(flight.errors_m[name] ** 2))) for flight in flights]),
        "end_rms_m": rms([float(flight.errors_m[name][-1]) for flight in flights]),
        "nees_position": mean(values.tolist()),
        **mean_interval("nees_position", values),
        "nees_position_end": mean([float(flight.nees[name][-1]) for flight in flights]),
    }
