# SPDX-License-Identifier: Apache-2.0
"""Two vehicles whose map frames differ and whose landmarks look alike, made from flights in a common frame.

Another start pose only moves a vehicle's own map.
"""

import dataclasses
from collections.abc import Callable, Collection
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from uav_vslam.config import VehicleConfig
from uav_vslam.cooperation.point_pairs import rotated
from uav_vslam.evaluation.trajectory import Trajectory
from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.rotation import quaternion_wxyz_from_rotation, rotation_from_rpy
from uav_vslam.offline.track import track_vehicle
from uav_vslam.pipeline import VehicleTrack
from uav_vslam.simulation.landmarks import LandmarkField, LandmarkNoise, scatter_landmarks
from uav_vslam.simulation.scenario import FLEET, Scenario, simulate_fleet
from uav_vslam.simulation.source import SimulatedSource
from uav_vslam.studies.engine.association_stages import Identities
from uav_vslam.studies.engine.flights import exact_config, true_trajectory
from uav_vslam.types import JointInformation, PoseEstimate
from uav_vslam.vision.matching.nn_ratio import squared_distances

Array = NDArray[np.float64]

STREAM = 100  # of the random numbers, beside those of `simulation.scenario.Purpose`
SHIFT_M = (1.0, 50.0)


@dataclass(frozen=True, slots=True)
class OwnOnlyTracks:
    """Own-only tracks of a fleet, without exchange.

    Attributes:
        tracks, truths: by vehicle, each in its vehicle's map frame.
        landmarks: the simulated landmarks.
    """

    tracks: dict[str, VehicleTrack]
    truths: dict[str, Trajectory]
    landmarks: LandmarkField


def fly_own_only(
    scenario: Scenario, config: VehicleConfig | None = None, noise: LandmarkNoise | None = None
) -> OwnOnlyTracks:
    """Fly every vehicle alone, at landmark level, all in one frame; the scenario's IMU replaces `config.imu`."""
    vehicles = simulate_fleet(scenario)
    landmarks = scatter_landmarks(vehicles)
    config = dataclasses.replace(config or exact_config(), imu=scenario.imu_config)
    tracks = {v.name: track_vehicle(SimulatedSource(v, landmarks, noise), config) for v in vehicles}
    return OwnOnlyTracks(tracks, {v.name: true_trajectory(v) for v in vehicles}, landmarks)


def draw_offset(seed: int) -> Pose:
    """Draw a map frame: rotated by up to 180 degrees, shifted by SHIFT_M in any direction."""
    rng = np.random.default_rng([seed, FLEET, STREAM])
    direction = rng.normal(size=3)
    t = direction / np.linalg.norm(direction) * rng.uniform(*SHIFT_M)
    return Pose(rotation_from_rpy(0.0, 0.0, rng.uniform(-np.pi, np.pi)), t)


def in_other_frame(flown: OwnOnlyTracks, vehicle: str, T_new_old: Pose) -> OwnOnlyTracks:
    """Return the flights with one vehicle's map in another frame: its poses, landmarks and information."""
    track, truth = flown.tracks[vehicle], flown.truths[vehicle]
    outputs = []
    for output in track.outputs:
        report = dataclasses.replace(output.report, pose=_pose(output.report.pose, T_new_old))
        joint = _joint(output.joint, T_new_old) if output.joint is not None else None
        outputs.append(dataclasses.replace(output, report=report, joint=joint))
    rotations = quaternion_wxyz_from_rotation(T_new_old.R @ truth.rotations)
    moved = Trajectory(truth.stamps_ns, T_new_old.apply(truth.positions), rotations)
    return dataclasses.replace(
        flown,
        tracks={**flown.tracks, vehicle: dataclasses.replace(track, outputs=outputs)},
        truths={**flown.truths, vehicle: moved},
    )


def mistaken(
    flown: OwnOnlyTracks, vehicle: str, share: float, seed: int, *, among: Collection[int]
) -> tuple[OwnOnlyTracks, set[int]]:
    """Give a share of one vehicle's landmarks the descriptor of another one of them for the whole flight.

    Args:
        flown: the flights.
        vehicle: whose landmarks.
        share: of those.
        seed: draws them.
        among: identifiers of those that may be mistaken. Where another vehicle has all of them, it will confuse them:
            a landmark that resembles an unknown one is just not matched.

    Returns:
        The flights, and the identifiers of the landmarks with a wrong descriptor.
    """
    track, ids = flown.tracks[vehicle], sorted(among)
    drawn = np.random.default_rng([seed, FLEET, STREAM + 1]).uniform(size=len(ids)) < share
    wrong = {k for k, is_wrong in zip(ids, drawn, strict=True) if is_wrong}

    def confused(joint: JointInformation) -> JointInformation:
        rows = np.flatnonzero([k in wrong for k in joint.ids.tolist()])
        descriptors = joint.descriptors.copy()
        descriptors[rows] = descriptors[np.roll(rows, 1)]
        return dataclasses.replace(joint, descriptors=descriptors)

    return dataclasses.replace(flown, tracks={**flown.tracks, vehicle: with_joints(track, confused)}), wrong


def with_joints(track: VehicleTrack, change: Callable[[JointInformation], JointInformation]) -> VehicleTrack:
    """Return a track with other joint information at its epochs."""
    outputs = [
        output if output.joint is None else dataclasses.replace(output, joint=change(output.joint))
        for output in track.outputs
    ]
    return dataclasses.replace(track, outputs=outputs)


def with_mistaken_landmarks(flown: OwnOnlyTracks, share: float, seed: int) -> tuple[OwnOnlyTracks, Identities]:
    """Return the flights with a share of what the first two vehicles have in common `mistaken`, and the truth."""
    first, second = sorted(flown.tracks)[:2]
    own, peer = identities(flown, first), identities(flown, second)
    known = set(own.values())
    shared = [k for k, name in peer.items() if name in known]
    modified, wrong = mistaken(flown, second, share, seed, among=shared)
    return modified, Identities(own, peer, wrong)


def identities(flown: OwnOnlyTracks, vehicle: str) -> dict[int, int]:
    """Return which landmark of the field each identifier of a vehicle is: the one with the nearest descriptor."""
    found: dict[int, int] = {}
    for output in flown.tracks[vehicle].outputs:
        if output.joint is not None:
            nearest = squared_distances(output.joint.descriptors, flown.landmarks.descriptors).argmin(axis=1)
            found |= dict(zip(output.joint.ids.tolist(), nearest.tolist(), strict=True))
    return found


def _pose(estimate: PoseEstimate, T_new_old: Pose) -> PoseEstimate:
    return PoseEstimate(estimate.stamp_ns, T_new_old @ estimate.T_map_body, rotated(estimate.covariance, T_new_old.R))


def _joint(joint: JointInformation, T_new_old: Pose) -> JointInformation:
    """Position, rotation and landmarks are all vectors in the map frame, so information is rotated block by block."""
    return dataclasses.replace(
        joint,
        T_map_body=T_new_old @ joint.T_map_body,
        positions=T_new_old.apply(joint.positions),
        information=rotated(joint.information, T_new_old.R),
    )
