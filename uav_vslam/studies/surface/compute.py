# SPDX-License-Identifier: Apache-2.0
"""Flies one seed over rendered ground and maps it by each method."""

import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from uav_vslam.evaluation.scores import error_scores
from uav_vslam.evaluation.trajectory import Trajectory
from uav_vslam.simulation.scenario import Scenario
from uav_vslam.simulation.terrain import ground_of
from uav_vslam.studies.engine.flights import true_trajectory
from uav_vslam.studies.engine.kept_flights import KeptFlight, height_grid, kept_flights
from uav_vslam.studies.surface.scoring import Scores, Surface, score
from uav_vslam.studies.surface.sparse import DelaunaySurface, extra_points, landmarks
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
    flights = kept_flights(scenario, ground)
    fused = job.vehicles > 1
    truths = {flight.simulated.name: true_trajectory(flight.simulated) for flight in flights}
    surfaces = {}
    for kind in ["smoothed"] + ["anchored"] * fused:
        estimates = {flight.simulated.name: Trajectory.from_estimates(flight.poses(kind)) for flight in flights}
        for surface in surfaces_of(flights, kind, job.cell_m):
            surfaces[surface.method, kind] = score(surface, ground, flights, estimates, truths)
    scored = {
        kind: [
            error_scores(Trajectory.from_estimates(flight.poses(kind)), truths[flight.simulated.name])
            for flight in flights
        ]
        for kind in ["s_slam", "smoothed"] + ["c_slam", "anchored"] * fused
    }
    return MappedSeed(surfaces, scored)


def surfaces_of(flights: list[KeptFlight], kind: str, cell_m: float) -> Iterator[Surface]:
    """Yield the surface by each method, with one kind of poses."""
    frames = sum(len(flight.frames) for flight in flights)
    started = time.process_time()
    grid = height_grid(flights, kind, cell_m)
    raster = grid.extent.grown(MARGIN)
    window = grid.window(raster)
    ms = 1e3 * (time.process_time() - started) / frames
    yield Surface("motion stereo", raster, window.height, window.sigma, ms)
    found, extra = [], []
    for flight in flights:
        at = {pose.stamp_ns: pose.T_map_body for pose in flight.poses(kind)}
        rig, features = flight.simulated.rig, flight.track.features
        found.append(landmarks(list(features.values()), at, rig))
        for frame in flight.frames[::EVERY]:
            if frame.stamp_ns in at:
                pair = to_grey8(frame.left), to_grey8(frame.right)
                extra.append(extra_points(*pair, features[frame.stamp_ns], at[frame.stamp_ns], rig))
    for method, points in (("rig's pair", np.vstack(found + extra)), ("landmarks", np.vstack(found))):
        yield Surface(method, raster, DelaunaySurface(points).height(raster), None, None)
