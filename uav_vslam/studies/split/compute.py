# SPDX-License-Identifier: Apache-2.0
"""The legs of a recording as vehicles that fly at once, from many drawn starts, in each communication mode.

Features depend neither on the start nor on the radio, so the images are searched once; own-only tracks do not depend on
the radio, so they are computed once for all modes.
"""

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from uav_vslam.config import StartConfig, VehicleConfig
from uav_vslam.datasets.bag_flight import BagFlight
from uav_vslam.datasets.cut_writer import MARGIN_NS
from uav_vslam.datasets.cutting import WHAT_A_CUT_HIDES, Cut, CutVehicle, with_drawn_starts
from uav_vslam.errors import UavVslamError
from uav_vslam.evaluation.trajectory import Trajectory
from uav_vslam.fleet import cooperate
from uav_vslam.offline.result import link_counters
from uav_vslam.offline.track import track_vehicle
from uav_vslam.studies.engine.pool import in_pool
from uav_vslam.studies.engine.recorded_flights import RecordedFlight, features_of
from uav_vslam.types import ImuSample, StereoFeatures, StereoFrame
from uav_vslam.vision.frontends import make_frontend

INS, S_SLAM = "INS", "S-SLAM"
C_SLAM = {"wideband": "C-SLAM wideband", "narrowband": "C-SLAM narrowband"}
METHODS = (INS, S_SLAM, *C_SLAM.values())

NOTES = {
    "Starts": "each seed draws the errors of all start states from their covariance; the recording, its noise and its "
    "images are the same, so the intervals are over starts of one flight, not over flights.",
    "S-SLAM": "is communication mode none.",
    "Errors": "root mean squares over the seeds, and for `both` or `all` over the vehicles, in the truth's frame, "
    "without alignment.",
    "NEES": "squared position error over the covariance, per axis, from the 21st frame on: 1 is consistent.",
    "What a cut hides": WHAT_A_CUT_HIDES + ".",
}


@dataclass(frozen=True, slots=True)
class Outcome:
    """One seed.

    Attributes:
        seed: of the starts.
        tracks: by method and vehicle; no methods if a filter diverged.
        packets_used: by method and vehicle.
        failure: why there are no tracks.
    """

    seed: int
    tracks: dict[str, dict[str, Trajectory]] = field(default_factory=dict)
    packets_used: dict[str, dict[str, int]] = field(default_factory=dict)
    failure: str = ""


def searched_legs(
    flight: BagFlight, cut: Cut, poses: Trajectory, config: VehicleConfig, on_frame: Callable[[], None] = lambda: None
) -> list[RecordedFlight]:
    """Return each leg with its features, in the time that all vehicles share.

    Args:
        flight: the source.
        cut: its legs.
        poses: true poses of the whole flight.
        config: of the front end.
        on_frame: called for each image pair of a leg.
    """
    frontends = [make_frontend(flight.rig, config.frontend, config.rig) for _ in cut.vehicles]
    events: list[list[ImuSample | StereoFeatures]] = [[] for _ in cut.vehicles]
    for event in flight.iter_events():
        for vehicle, frontend, kept in zip(cut.vehicles, frontends, events, strict=True):
            if not _belongs(event, vehicle):
                continue
            moved = dataclasses.replace(event, stamp_ns=event.stamp_ns + vehicle.shift_ns)
            if isinstance(moved, ImuSample):
                kept.append(moved)
            else:
                kept.append(features_of(moved, frontend))
                on_frame()
    return [_leg(flight, vehicle, kept, poses) for vehicle, kept in zip(cut.vehicles, events, strict=True)]


def _belongs(event: ImuSample | StereoFrame, vehicle: CutVehicle) -> bool:
    margin_ns = MARGIN_NS if isinstance(event, ImuSample) else 0
    return vehicle.first_ns - margin_ns <= event.stamp_ns <= vehicle.last_ns + margin_ns


def _leg(
    flight: BagFlight, vehicle: CutVehicle, events: Sequence[ImuSample | StereoFeatures], poses: Trajectory
) -> RecordedFlight:
    truth = dataclasses.replace(poses, stamps_ns=poses.stamps_ns + vehicle.shift_ns)
    return RecordedFlight(vehicle.name, flight.rig, vehicle.start, tuple(events), truth, np.zeros((len(truth), 3)))


def run_starts(
    legs: list[RecordedFlight],
    cut: Cut,
    config: VehicleConfig,
    seeds: Sequence[int],
    *,
    workers: int = 1,
    on_run: Callable[[], None] = lambda: None,
) -> list[Outcome]:
    """Fly all legs from the starts of every seed, and return the outcomes in the seeds' order."""
    config = dataclasses.replace(config, start=StartConfig(method="given"))
    jobs = [(legs, with_drawn_starts(cut, seed), config, seed) for seed in seeds]
    return list(in_pool(run_seed, jobs, workers, on_run))


def run_seed(job: tuple[list[RecordedFlight], Cut, VehicleConfig, int]) -> Outcome:
    """Fly all legs once alone, then exchange packets in each mode."""
    legs, cut, config, seed = job
    try:
        tracks = {
            leg.vehicle: track_vehicle(_started(leg, own), config) for leg, own in zip(legs, cut.vehicles, strict=True)
        }
        fleets = {
            label: cooperate(tracks, dict.fromkeys(tracks, _in_mode(config, mode))) for mode, label in C_SLAM.items()
        }
    except (UavVslamError, np.linalg.LinAlgError) as error:
        return Outcome(seed, failure=str(error))
    found = {
        INS: {name: [output.dead_reckoning.pose for output in track.outputs] for name, track in tracks.items()},
        S_SLAM: {name: track.poses for name, track in tracks.items()},
    } | {label: {name: member.poses for name, member in fleet.items()} for label, fleet in fleets.items()}
    return Outcome(
        seed,
        {
            label: {name: Trajectory.from_estimates(poses) for name, poses in own.items()}
            for label, own in found.items()
        },
        {
            label: {name: link_counters(member).packets_used for name, member in fleet.items()}
            for label, fleet in fleets.items()
        },
    )


def _started(leg: RecordedFlight, vehicle: CutVehicle) -> RecordedFlight:
    """Return the leg with a start in the time that all vehicles share."""
    state = dataclasses.replace(vehicle.start.state, stamp_ns=vehicle.first_ns + vehicle.shift_ns)
    return dataclasses.replace(leg, initial_state=dataclasses.replace(vehicle.start, state=state))


def _in_mode(config: VehicleConfig, mode: str) -> VehicleConfig:
    return dataclasses.replace(config, fusion=dataclasses.replace(config.fusion, mode=mode))
