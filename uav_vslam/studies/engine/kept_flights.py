# SPDX-License-Identifier: Apache-2.0
"""Rendered flights whose images are kept for maps, with the poses that the estimator gives them."""

import dataclasses
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from uav_vslam.config import find_config, load_vehicle
from uav_vslam.fleet import CooperativeTrack
from uav_vslam.mapping.anchoring import anchored
from uav_vslam.mapping.flight_views import flight_views
from uav_vslam.mapping.surface.grid import HeightGrid
from uav_vslam.mapping.surface.mapper import SurfaceMapper
from uav_vslam.mapping.view import View
from uav_vslam.offline.flight import fly
from uav_vslam.offline.source import FlightSource
from uav_vslam.pipeline import VehicleTrack
from uav_vslam.simulation.camera_render import RenderedFlight
from uav_vslam.simulation.scenario import Scenario, SimulatedVehicle, simulate_fleet
from uav_vslam.simulation.source import SimulatedSource
from uav_vslam.simulation.terrain import Ground
from uav_vslam.studies.engine.flights import true_trajectory
from uav_vslam.types import PoseEstimate, StereoFrame
from uav_vslam.vision.frontends import make_frontend


@dataclass(frozen=True, slots=True)
class KeptFlight:
    """One vehicle's flight.

    Attributes:
        simulated: the vehicle.
        frames: its stereo pairs, in stamp order.
        track: own-only and smoothed, with the features.
        member: fused with its peers.
    """

    simulated: SimulatedVehicle
    frames: tuple[StereoFrame, ...]
    track: VehicleTrack
    member: CooperativeTrack

    def poses(self, kind: str) -> list[PoseEstimate]:
        """Return the poses of one kind: truth, s_slam, c_slam, smoothed, or anchored: smoothed, but where C-SLAM is."""
        if kind == "truth":
            return true_trajectory(self.simulated).estimates()
        if kind == "s_slam":
            return self.track.poses
        if kind == "c_slam":
            return list(self.member.poses)
        return anchored(self.track.smoothed, self.member.poses) if kind == "anchored" else self.track.smoothed

    def views(self, kind: str) -> Iterator[View]:
        """Yield the views with one kind of poses."""
        poses = {pose.stamp_ns: pose.T_map_body for pose in self.poses(kind)}
        images = ((frame.stamp_ns, frame.left) for frame in self.frames)
        return flight_views(self.simulated.name, self.simulated.rig, poses, images)


def height_grid(flights: Sequence[KeptFlight], kind: str, cell_m: float) -> HeightGrid:
    """Map flights by motion stereo, with one kind of poses; `cell_m` is the side of a cell [m]."""
    grid = HeightGrid(cell_m)
    mapper = SurfaceMapper(grid)
    for flight in flights:
        for view in flight.views(kind):
            mapper.add_view(view)
    mapper.finish()
    return grid


def kept_flights(scenario: Scenario, ground: Ground) -> list[KeptFlight]:
    """Render a scenario's images and fly its vehicles together, with the configuration of the Kagaru flights.

    Raises:
        UavVslamError: the filter diverged.
    """
    config = dataclasses.replace(load_vehicle(find_config("kagaru")), imu=scenario.imu_config)
    vehicles = simulate_fleet(scenario)
    frames = {vehicle.name: tuple(RenderedFlight(vehicle, ground)) for vehicle in vehicles}
    sources: list[FlightSource] = []
    for vehicle in vehicles:
        frontend = make_frontend(vehicle.rig, config.frontend, config.rig)
        sources.append(SimulatedSource(vehicle, features=tuple(map(frontend.process, frames[vehicle.name]))))
    configs = {vehicle.name: config for vehicle in vehicles}
    tracks, fleet = fly(sources, configs, keep_features=True, smoothing=True)
    return [KeptFlight(v, frames[v.name], tracks[v.name], fleet[v.name]) for v in vehicles]
