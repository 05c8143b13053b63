# SPDX-License-Identifier: Apache-2.0
"""Flights whose features have been extracted once, with each feature's true point: for scoring associations.

In rendered images a feature shows the point where its true ray intersects the ground. In a recording with
true poses it shows the point triangulated from its stereo pixels. Whether another feature shows the same is decided
in its own image, where that point must project within a few pixels.
"""

import dataclasses
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from uav_vslam.config import VehicleConfig
from uav_vslam.evaluation.pairing import MAX_GAP_S
from uav_vslam.evaluation.trajectory import Trajectory, interpolate
from uav_vslam.geometry.camera import PinholeCamera
from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.stereo import StereoRig
from uav_vslam.simulation.camera_render import RenderedFlight, intersect
from uav_vslam.simulation.scenario import Scenario, simulate_vehicle
from uav_vslam.simulation.terrain import Relief, relief_of
from uav_vslam.studies.engine.flights import true_trajectory
from uav_vslam.studies.engine.own_only import Step, dead_reckon
from uav_vslam.studies.engine.recorded_flights import RecordedFlight
from uav_vslam.types import ImuSample, NavEstimate, StereoFeatures
from uav_vslam.vision.stereo_points import DetectedPair, StereoFrontend

Array = NDArray[np.float64]

RENDERED_PX = 4.0  # four times the error of a point found at half resolution
RECORDED_PX = 8.0  # besides, the depth of a point in a room is known to some 3 %


@dataclass(frozen=True, slots=True)
class ExtractedFlight:
    """One vehicle's flight.

    Attributes:
        condition: label.
        seed: of the simulation; 0 for a recording.
        rig, initial, config: calibration, start state and settings of the vehicle.
        steps: each frame's features, and the motion to it (None for the first).
        truth, ins: true and dead-reckoned poses at the frames.
        T_world_left: true pose of the left camera at each frame.
        points: of each frame the (N, 3) points in the world that its features truly show [m].
        tolerance_px: how far from its true position a feature may be.
        pairs: keypoints of both images of some frames, by frame number; of rendered flights alone.
        relief: the true ground; of rendered flights alone.
    """

    condition: str
    seed: int
    rig: StereoRig
    initial: NavEstimate
    config: VehicleConfig
    steps: tuple[Step, ...]
    truth: Trajectory
    ins: Trajectory
    T_world_left: tuple[Pose, ...]
    points: tuple[Array, ...]
    tolerance_px: float
    pairs: dict[int, DetectedPair] = dataclasses.field(default_factory=dict)
    relief: Relief | None = None


def rendered_flight(condition: str, scenario: Scenario, config: VehicleConfig, *, keep: set[int]) -> ExtractedFlight:
    """Render the images of a scenario's first vehicle and extract their features.

    Args:
        condition: label.
        scenario: the flight.
        config: of the vehicle; the scenario's IMU replaces `imu`.
        keep: frames of which all keypoints are kept.
    """
    vehicle = simulate_vehicle(scenario, 0)
    frontend = StereoFrontend(vehicle.rig, config.frontend, config.rig)
    features, pairs = [], {}
    for frame, images in enumerate(RenderedFlight(vehicle)):
        found = frontend.detect(images)
        features.append(frontend.match(found))
        if frame in keep:
            pairs[frame] = found
    relief = relief_of(scenario)
    T_world_left = tuple(vehicle.truth.pose(float(t)) @ vehicle.rig.T_body_left for t in vehicle.frame_times_s)
    points = tuple(
        ground_points(relief, T, vehicle.rig.left, seen.pixels[:, :2].astype(float))
        for T, seen in zip(T_world_left, features, strict=True)
    )
    stamps = [seen.stamp_ns for seen in features]
    increments, ins = dead_reckon(vehicle.initial, scenario.imu_config, vehicle.imu.samples(), stamps)
    return ExtractedFlight(
        condition=condition,
        seed=scenario.seed,
        rig=vehicle.rig,
        initial=vehicle.initial,
        config=dataclasses.replace(config, imu=scenario.imu_config),
        steps=tuple(zip(features, increments, strict=True)),
        truth=true_trajectory(vehicle),
        ins=ins,
        T_world_left=T_world_left,
        points=points,
        tolerance_px=RENDERED_PX,
        pairs=pairs,
        relief=relief,
    )


def recorded_flight(condition: str, flight: RecordedFlight, config: VehicleConfig) -> ExtractedFlight:
    """Return a recording from its recorded start to the end of the truth."""
    stamps = flight.frame_stamps_ns
    stamps = stamps[stamps >= flight.initial_state.state.stamp_ns]
    truth = interpolate(flight.truth, stamps, max_gap_s=MAX_GAP_S)[0]
    wanted = set(truth.stamps_ns.tolist())
    features = [e for e in flight.events if isinstance(e, StereoFeatures) and e.stamp_ns in wanted]
    samples = [e for e in flight.events if isinstance(e, ImuSample)]
    stamps_ns = [seen.stamp_ns for seen in features]
    increments, ins = dead_reckon(flight.initial_state, config.imu, samples, stamps_ns)
    poses = [Pose(R, t) @ flight.rig.T_body_left for R, t in zip(truth.rotations, truth.positions, strict=True)]
    points = [
        T.apply(flight.rig.triangulate(seen.pixels.astype(float))) for T, seen in zip(poses, features, strict=True)
    ]
    return ExtractedFlight(
        condition=condition,
        seed=0,
        rig=flight.rig,
        initial=flight.initial_state,
        config=config,
        steps=tuple(zip(features, increments, strict=True)),
        truth=truth,
        ins=ins,
        T_world_left=tuple(poses),
        points=tuple(points),
        tolerance_px=RECORDED_PX,
    )


def ground_points(relief: Relief, T_world_cam: Pose, camera: PinholeCamera, pixels: NDArray[np.floating]) -> Array:
    """Return the (N, 3) points of the ground that (N, 2) undistorted pixels show [m]."""
    return intersect(relief, T_world_cam.t, camera.bearings(pixels) @ T_world_cam.R.T)


def shown_at(T_world_cam: Pose, camera: PinholeCamera, points_world: Array) -> Array:
    """Return the (N, 2) undistorted pixels where points are seen; NaN for points behind the camera or unknown."""
    points = T_world_cam.inverse().apply(points_world)
    ahead = points[:, 2] > 0
    pixels = camera.project(np.where(ahead[:, None], points, [0.0, 0.0, 1.0]))
    return np.where(ahead[:, None], pixels, np.nan)
