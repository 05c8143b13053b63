# SPDX-License-Identifier: Apache-2.0
"""Flies one seed over rendered ground and maps it by each method."""

import heapq
import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import Any

import cv2
import numpy as np

from uav_vslam.evaluation.trajectory import Trajectory
from uav_vslam.fleet import CooperativeTrack
from uav_vslam.geometry.stereo import StereoRig
from uav_vslam.mapping.anchoring import anchored
from uav_vslam.mapping.flight_views import flight_views
from uav_vslam.mapping.raster import Raster
from uav_vslam.mapping.surface.grid import HeightGrid
from uav_vslam.mapping.surface.mapper import SurfaceMapper
from uav_vslam.mapping.surface.sparse import DelaunaySurface, extra_points, landmarks
from uav_vslam.offline import FlightSource, fly
from uav_vslam.pipeline import VehicleTrack
from uav_vslam.simulation.camera_render import RenderedFlight
from uav_vslam.simulation.scenario import Scenario, SimulatedVehicle, simulate_fleet
from uav_vslam.simulation.terrain import Ground, ground_of
from uav_vslam.studies.engine.flights import kagaru_configs, true_trajectory
from uav_vslam.studies.surface.scoring import Scores, Surface, pose_scores, score
from uav_vslam.types import ImuSample, NavEstimate, PoseEstimate, StereoFeatures, StereoFrame
from uav_vslam.vision.images import to_grey8

NOTES = {
    "Heights": "cells with a height of their own or filled, against the true surface at the place where the vehicle "
    "really was: the error of the nearest pose is removed, but not in absolute_median_m. Open ground is 1.5 m and more "
    "from what stands; medians and 95 % are of the absolute error, and figures are means over the seeds",
    "Methods": "motion stereo between views of one flight; the rig's pair: landmarks and a lattice of points matched "
    "in single stereo pairs, then Delaunay (5.6.1 of the thesis); landmarks: Delaunay of tracked features (5.4)",
    "Poses": "smoothed: the own-only smoother's; anchored: those, moved to where C-SLAM is",
    "Times": "processor time for a frame flown, on top of the estimation",
}
MARGIN = 30  # cells around the map in which coverage counts too
EVERY = 3  # frames from which the rig's pair takes points: their views overlap by 80 %


@dataclass(frozen=True, slots=True)
class Job:
    """One seed."""

    seed: int
    frames: int
    vehicles: int
    objects: bool
    cell_m: float


@dataclass(slots=True)
class KeptFlight:
    """A rendered flight as the source of the pipeline, whose images are kept for the map."""

    simulated: SimulatedVehicle
    ground: Ground
    kept: list[StereoFrame] = field(default_factory=list)

    @property
    def vehicle(self) -> str:
        """Name."""
        return self.simulated.name

    @property
    def rig(self) -> StereoRig:
        """Calibration."""
        return self.simulated.rig

    @property
    def initial_state(self) -> NavEstimate:
        """Start state with its errors."""
        return self.simulated.initial

    @property
    def frame_count(self) -> int:
        """Number of frames."""
        return len(self.simulated.frame_stamps_ns)

    def unpaired_reason(self) -> str:
        """Return nothing: all images are pairs."""
        return ""

    def iter_events(self) -> Iterable[ImuSample | StereoFrame | StereoFeatures]:
        """Yield sensor data in stamp order."""
        return heapq.merge(self.simulated.imu.samples(), self._frames(), key=lambda event: event.stamp_ns)

    def _frames(self) -> Iterator[StereoFrame]:
        for frame in RenderedFlight(self.simulated, self.ground):
            self.kept.append(frame)
            yield frame


@dataclass(frozen=True, slots=True)
class MappedSeed:
    """Results of one seed.

    Attributes:
        surfaces: scores by method and kind of poses.
        poses: scores of each vehicle's poses, by kind.
    """

    surfaces: dict[tuple[str, str], Scores]
    poses: dict[str, list[dict[str, Any]]]


def map_seed(job: Job) -> MappedSeed:
    """Fly and map one seed."""
    cv2.setNumThreads(1)
    scenario = Scenario(seed=job.seed, frames=job.frames, vehicles=job.vehicles, objects=job.objects)
    ground = ground_of(scenario)
    flights = [KeptFlight(vehicle, ground) for vehicle in simulate_fleet(scenario)]
    config = kagaru_configs({"": {}})[""]
    sources: list[FlightSource] = list(flights)
    tracks, fleet = fly(sources, {f.vehicle: config for f in flights}, keep_features=True, smoothing=True)
    kinds = ["smoothed"] + ["anchored"] * (job.vehicles > 1)
    truths = {flight.vehicle: true_trajectory(flight.simulated) for flight in flights}
    surfaces = {}
    for kind in kinds:
        poses = {f.vehicle: poses_of(kind, tracks[f.vehicle], fleet[f.vehicle]) for f in flights}
        for surface in surfaces_of(flights, tracks, poses, job.cell_m):
            surfaces[surface.method, kind] = score(surface, ground, flights, poses, truths)
    scored = {
        kind: [
            pose_scores(Trajectory.from_estimates(poses_of(kind, tracks[name], fleet[name])), truth)
            for name, truth in truths.items()
        ]
        for kind in ["s_slam", "smoothed"] + ["c_slam", "anchored"] * (job.vehicles > 1)
    }
    return MappedSeed(surfaces, scored)


def poses_of(kind: str, track: VehicleTrack, member: CooperativeTrack) -> list[PoseEstimate]:
    """Return a vehicle's poses of one kind."""
    if kind == "s_slam":
        return [output.report.pose for output in track.outputs]
    if kind == "c_slam":
        return list(member.poses)
    return anchored(track.smoothed, member.poses) if kind == "anchored" else track.smoothed


def surfaces_of(
    flights: list[KeptFlight], tracks: dict[str, VehicleTrack], poses: dict[str, list[PoseEstimate]], cell_m: float
) -> Iterator[Surface]:
    """Yield the surface by each method."""
    frames = sum(len(flight.kept) for flight in flights)
    started = time.process_time()
    grid = HeightGrid(cell_m)
    mapper = SurfaceMapper(grid)
    for flight in flights:
        at = {pose.stamp_ns: pose.T_map_body for pose in poses[flight.vehicle]}
        images = ((frame.stamp_ns, frame.left) for frame in flight.kept)
        for view in flight_views(flight.vehicle, flight.rig, at, images):
            mapper.add_view(view)
    mapper.finish()
    known = grid.extent
    raster = Raster(
        cell_m, known.column - MARGIN, known.row - MARGIN, known.columns + 2 * MARGIN, known.rows + 2 * MARGIN
    )
    window = grid.window(raster)
    ms = 1e3 * (time.process_time() - started) / frames
    yield Surface("motion stereo", raster, window.height, window.sigma, ms)
    found, extra = [], []
    for flight in flights:
        at = {pose.stamp_ns: pose.T_map_body for pose in poses[flight.vehicle]}
        features = tracks[flight.vehicle].features
        found.append(landmarks(list(features.values()), at, flight.rig))
        for frame in flight.kept[::EVERY]:
            if frame.stamp_ns in at:
                pair = to_grey8(frame.left), to_grey8(frame.right)
                extra.append(extra_points(*pair, features[frame.stamp_ns], at[frame.stamp_ns], flight.rig))
    for method, points in (("rig's pair", np.vstack(found + extra)), ("landmarks", np.vstack(found))):
        yield Surface(method, raster, DelaunaySurface(points).height(raster), None, None)
