# SPDX-License-Identifier: Apache-2.0
"""Rendered flights of two vehicles, with their images and the poses that the estimator gives them."""

import dataclasses
from collections.abc import Iterator
from dataclasses import dataclass

from uav_vslam.config import VehicleConfig
from uav_vslam.evaluation.result import VehicleResult
from uav_vslam.geometry.pose import Pose
from uav_vslam.mapping.anchoring import anchored
from uav_vslam.mapping.flight_views import flight_views
from uav_vslam.mapping.view import Image, View
from uav_vslam.offline import flight_result, fly, smooth_track
from uav_vslam.simulation.camera_render import RenderedFlight
from uav_vslam.simulation.scenario import Scenario, SimulatedVehicle, simulate_fleet
from uav_vslam.simulation.source import SimulatedSource
from uav_vslam.simulation.terrain import Ground
from uav_vslam.studies.engine.flights import kagaru_configs, true_trajectory
from uav_vslam.vision.frontends import make_frontend

TRUE, SMOOTHED, ANCHORED = "true poses", "smoothed S-SLAM", "anchored C-SLAM"
CONFIG = "kagaru"

Poses = dict[int, Pose]  # T_map_body by stamp [ns]


@dataclass(frozen=True, slots=True)
class PicturedFlight:
    """A vehicle's left images by stamp [ns], and the poses of each kind."""

    vehicle: SimulatedVehicle
    images: dict[int, Image]
    poses: dict[str, Poses]

    def views(self, kind: str) -> Iterator[View]:
        """Yield the views with one kind of poses."""
        return flight_views(self.vehicle.name, self.vehicle.rig, self.poses[kind], self.images.items())


def pictured_flights(scenario: Scenario, ground: Ground) -> list[PicturedFlight]:
    """Render and fly a scenario, two vehicles or more together.

    Raises:
        UavVslamError: the filter diverged, or a flight could not be smoothed.
    """
    config = dataclasses.replace(kagaru_configs({CONFIG: {}})[CONFIG], imu=scenario.imu_config)
    vehicles = simulate_fleet(scenario)
    sources, images = zip(*(_followed(vehicle, ground, config) for vehicle in vehicles), strict=True)
    configs = {vehicle.name: config for vehicle in vehicles}
    tracks, fleet = fly(list(sources), configs, keep_features=True)
    for source in sources:
        smooth_track(tracks[source.vehicle], source.rig, config)
    result = flight_result(scenario.name, tracks, fleet, {v.name: true_trajectory(v) for v in vehicles}, configs)
    return [
        PicturedFlight(vehicle, pixels, _poses(result.vehicles[vehicle.name]))
        for vehicle, pixels in zip(vehicles, images, strict=True)
    ]


def _followed(
    vehicle: SimulatedVehicle, ground: Ground, config: VehicleConfig
) -> tuple[SimulatedSource, dict[int, Image]]:
    """Return a vehicle's features as a source, and its left images."""
    frontend = make_frontend(vehicle.rig, config.frontend, config.rig)
    features, images = [], {}
    for frame in RenderedFlight(vehicle, ground):
        features.append(frontend.process(frame))
        images[frame.stamp_ns] = frame.left.astype("uint8", copy=False)
    return SimulatedSource(vehicle, features=tuple(features)), images


def _poses(result: VehicleResult) -> dict[str, Poses]:
    tracks = {TRUE: result.truth, SMOOTHED: result.smoothed}
    kinds = {kind: [] if track is None else track.estimates() for kind, track in tracks.items()}
    if result.c_slam is not None and kinds[SMOOTHED]:
        kinds[ANCHORED] = anchored(kinds[SMOOTHED], result.c_slam.estimates())
    return {kind: {pose.stamp_ns: pose.T_map_body for pose in poses} for kind, poses in kinds.items()}
