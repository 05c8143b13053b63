# SPDX-License-Identifier: Apache-2.0
"""One flight as several vehicles at the same time (section 7.4 of [thesis]): which legs, and where each one starts."""

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from uav_vslam.config import InputConfig, VehicleConfig
from uav_vslam.datasets.bag import open_flight
from uav_vslam.datasets.bag import vehicles as vehicles_of
from uav_vslam.datasets.bag_flight import BagFlight
from uav_vslam.datasets.cut_options import CutOptions
from uav_vslam.datasets.seen_points import seen_flight
from uav_vslam.datasets.starts import drawn_start, true_start
from uav_vslam.datasets.truth import trajectory_of
from uav_vslam.errors import BagError, UavVslamError
from uav_vslam.evaluation.attitude import never_turns
from uav_vslam.evaluation.legs import Leg, Meeting, choose_legs, legs_by_hand, meeting_of
from uav_vslam.evaluation.overlap import overlap_of
from uav_vslam.evaluation.trajectory import Trajectory
from uav_vslam.types import NS_PER_S, NavEstimate

Array = NDArray[np.float64]

WHAT_A_CUT_HIDES = (
    "the vehicles share lens, calibration, IMU and its biases, so errors that differ between real vehicles are common "
    "here; each sees the ground as the other saw it earlier or later, in other light, while real vehicles "
    "also see each other's wind, vibration and moving shadows at one time; clocks agree and the radio is not part of "
    "the recording. It shows what common landmarks are worth, not what a fleet in the air achieves"
)


@dataclass(frozen=True, slots=True)
class CutVehicle:
    """One leg as a vehicle.

    Attributes:
        name: ROS namespace.
        first_ns, last_ns: stamps of its first and of its last image pair in the source [ns].
        frames: number of image pairs from the one to the other, with a pose or without.
        shift_ns: added to all stamps, so that all vehicles start at once [ns].
        start: state at the first image pair, with the source's stamp.
    """

    name: str
    first_ns: int
    last_ns: int
    frames: int
    shift_ns: int
    start: NavEstimate


@dataclass(frozen=True, slots=True)
class Cut:
    """A flight as several.

    Attributes:
        vehicles: in the order of the flight; their starts are true.
        meetings: what each two of them have in common, by their names.
        zero_ns: stamp of the first image pair with a pose, from which times of the flight count [ns].
    """

    vehicles: tuple[CutVehicle, ...]
    meetings: dict[tuple[str, str], Meeting]
    zero_ns: int


def source_of(bag: Path, vehicle: str | None, config: InputConfig) -> BagFlight:
    """Open the recording to cut: the named vehicle's, or the first one's.

    Raises:
        BagError: it has none, or can't be read.
        CalibrationError: see `open_flight`.
    """
    names = [vehicle] if vehicle else vehicles_of([bag], config)
    if not names:
        raise BagError(f"bag {bag} holds no <vehicle>/{config.topics.left}; name its topics by input.topics")
    return open_flight(bag, names[0], config)


def poses_of(flight: BagFlight) -> tuple[Trajectory, Array]:
    """Return the recorded truth and its (N, 3) velocities [m/s].

    Raises:
        BagError: none was recorded.
    """
    truth = flight.truth()
    if not truth:
        raise BagError(
            f"the recording holds no usable {flight.input.topic(flight.vehicle, 'truth')} along which it could be cut; "
            "`uav-vslam cut --trajectory` takes an estimate instead"
        )
    return trajectory_of(truth), truth.velocities_world


def velocities_of(poses: Trajectory) -> Array:
    """Return (N, 3) velocities of a trajectory by central differences [m/s].

    Raises:
        UavVslamError: it has fewer than two poses.
    """
    if len(poses) < 2:
        raise UavVslamError(f"a trajectory of {len(poses)} poses is none along which a recording could be cut")
    times_s = (poses.stamps_ns - poses.stamps_ns[0]) / NS_PER_S
    return np.asarray(np.gradient(poses.positions, times_s, axis=0))


def plan_cut(
    flight: BagFlight,
    poses: Trajectory,
    velocities_world: Array,
    config: VehicleConfig,
    options: CutOptions,
    on_frame: Callable[[], None] = lambda: None,
) -> Cut:
    """Find the legs of a flight, or take those given, and measure what they have in common.

    Args:
        flight: the recording.
        poses: of the body in the world: the truth, or an estimate.
        velocities_world: (N, 3) velocity at each of them [m/s].
        config: of the vehicle.
        options: what is asked for.
        on_frame: called for each image pair.

    Raises:
        UavVslamError: the poses have no attitude, there are no such legs, or a leg has fewer than two frames.
    """
    if never_turns(poses):
        raise UavVslamError(
            "the poses along which to cut have one orientation throughout, as positions alone have, so no leg's start "
            "is known; `uav-vslam cut --trajectory` takes poses with the body's orientation, such as an estimate"
        )
    seen = seen_flight(flight, poses, config, on_frame)
    overlap = overlap_of(seen.views, flight.rig.left)
    stamps_ns = np.array(seen.stamps_ns, np.int64)
    first_ns, last_ns = int(stamps_ns[0]), int(stamps_ns[-1])
    if options.legs_s:
        legs = legs_by_hand(first_ns, list(options.legs_s))
    else:
        legs = choose_legs(
            overlap,
            first_ns,
            last_ns,
            vehicles=options.vehicles,
            within_s=options.within_s,
            duration_s=options.duration_s,
            min_overlap=options.min_overlap,
        )
    inside = [_frames_of(leg, stamps_ns) for leg in legs]
    starts = [true_start(poses, velocities_world, int(f[0]), flight.initial_state, config.imu) for f in inside]
    vehicles = [
        CutVehicle(f"uav{k}", int(f[0]), int(f[-1]), _count(seen.pairs_ns, f), int(inside[0][0] - f[0]), start)
        for k, (f, start) in enumerate(zip(inside, starts, strict=True), start=1)
    ]
    flown = {vehicle.name: Leg(vehicle.first_ns, vehicle.last_ns + 1) for vehicle in vehicles}
    meetings = {
        names: meeting_of(overlap, *(flown[name] for name in names), within_s=options.within_s)
        for names in combinations(flown, 2)
    }
    return Cut(tuple(vehicles), meetings, first_ns)


def with_drawn_starts(cut: Cut, seed: int) -> Cut:
    """Return the cut with start states that err as their covariance says; biases are estimates already."""
    vehicles = [
        dataclasses.replace(vehicle, start=drawn_start(vehicle.start, np.random.default_rng([seed, k]), biases=False))
        for k, vehicle in enumerate(cut.vehicles)
    ]
    return dataclasses.replace(cut, vehicles=tuple(vehicles))


def _count(pairs_ns: list[int], found: NDArray[np.int64]) -> int:
    """Return how many image pairs lie between the first and the last of a leg's frames, both included."""
    return sum(int(found[0]) <= stamp_ns <= int(found[-1]) for stamp_ns in pairs_ns)


def _frames_of(leg: Leg, stamps_ns: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the stamps of a leg's frames that have a pose."""
    found = stamps_ns[(stamps_ns >= leg.start_ns) & (stamps_ns < leg.end_ns)]
    if len(found) < 2:
        since_s = [(ns - int(stamps_ns[0])) / NS_PER_S for ns in (leg.start_ns, leg.end_ns)]
        whole_s = (int(stamps_ns[-1]) - int(stamps_ns[0])) / NS_PER_S
        raise UavVslamError(
            f"leg {since_s[0]:g}-{since_s[1]:g} s has {len(found)} image pairs with a pose; use longer ones within the "
            f"flight of {whole_s:.1f} s"
        )
    return found
