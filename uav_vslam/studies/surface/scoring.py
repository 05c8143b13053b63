# SPDX-License-Identifier: Apache-2.0
"""Scores of a surface against the true one."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation
from scipy.spatial import cKDTree

from uav_vslam.evaluation.trajectory import Trajectory
from uav_vslam.mapping.raster import Raster
from uav_vslam.simulation.terrain import Ground
from uav_vslam.studies.engine.kept_flights import KeptFlight

Array = NDArray[np.float64]
Scores = dict[str, float | None]

APART_M = 1.5  # of open ground from what stands
REACH_M, STEP_M = 3.0, 0.1  # of the profiles across a barn's edges
INSIDE_M, OUTSIDE_M = 0.5, 1.5  # from the edge, where roof and ground are taken from
CORNER_M = 1.0  # of an edge's ends that is left out
LEAST_RISE_M = 1.5  # of the roof over the ground


@dataclass(frozen=True, slots=True)
class Surface:
    """A surface to be scored.

    Attributes:
        method: how it was made.
        raster: where.
        height: (rows, columns) [m], NaN unknown.
        sigma: its standard deviation, NaN where not claimed; None if nowhere.
        ms_per_frame: processor time for a frame flown [ms]; None if not measured.
    """

    method: str
    raster: Raster
    height: NDArray[np.float32]
    sigma: NDArray[np.float32] | None
    ms_per_frame: float | None


def score(
    surface: Surface,
    ground: Ground,
    flights: Sequence[KeptFlight],
    estimates: Mapping[str, Trajectory],
    truths: Mapping[str, Trajectory],
) -> Scores:
    """Return the figures of one surface; `estimates` and `truths` are the poses of each vehicle, with equal stamps."""
    x, y = np.meshgrid(surface.raster.x, surface.raster.y)
    shift = _own_errors(x, y, estimates, truths)
    true_x, true_y = x + shift[..., 0], y + shift[..., 1]
    truth, labels = ground.height(true_x, true_y), ground.labels(true_x, true_y)
    error = surface.height - (truth - shift[..., 2])
    shown = _shown(surface.raster, x, y, ground, flights)
    known, standing = np.isfinite(error) & shown, labels > 0  # triangles also span what no image shows
    reach = round(APART_M / surface.raster.cell_m)
    free = known & ~binary_dilation(standing, iterations=reach)
    absolute = (surface.height - ground.height(x, y))[free]
    own = np.concatenate([estimates[name].positions[:, 2] - true.positions[:, 2] for name, true in truths.items()])
    open_error = error[free]
    level = open_error - np.median(open_error)
    scores: Scores = {
        "height_median_m": _median(open_error),
        "height_95_m": _percentile_95(open_error),
        "height_level_median_m": _median(level),
        "height_level_95_m": _percentile_95(level),
        "standing_median_m": _median(error[known & standing]),
        "barn_edge_m": _edges_m(surface, ground, shift),
        "coverage_share": float(np.mean(known[shown])),
        "absolute_median_m": _median(absolute),
        "own_height_median_m": _median(own),
        "ms_per_frame": surface.ms_per_frame,
    }
    if surface.sigma is not None:
        claimed = free & np.isfinite(surface.sigma)
        scores["nees_height"] = float(np.mean((error[claimed] / surface.sigma[claimed]) ** 2))
    return scores


def _own_errors(x: Array, y: Array, estimates: Mapping[str, Trajectory], truths: Mapping[str, Trajectory]) -> Array:
    """Return (..., 3) truth minus estimate of the pose nearest in plan [m]."""
    places = np.vstack([estimates[name].positions[:, :2] for name in truths])
    errors = np.vstack([truth.positions - estimates[name].positions for name, truth in truths.items()])
    _, nearest = cKDTree(places).query(np.stack([x, y], axis=-1))
    return np.asarray(errors[nearest])


def _shown(raster: Raster, x: Array, y: Array, ground: Ground, flights: Sequence[KeptFlight]) -> NDArray[np.bool_]:
    """Return the cells that some left image truly shows, but for what hides them."""
    shown = np.zeros(raster.shape, bool)
    points = np.stack([x, y, ground.height(x, y)], axis=-1)
    for flight in flights:
        vehicle, camera = flight.simulated, flight.simulated.rig.left
        for t in vehicle.frame_times_s:
            seen = (vehicle.truth.pose(float(t)) @ vehicle.rig.T_body_left).inverse().apply(points)
            pixels = camera.project(np.where(seen[..., 2:] > 0.0, seen, [0.0, 0.0, 1e-6]))
            shown |= ((pixels >= 0.0) & (pixels <= [camera.width - 1, camera.height - 1])).all(axis=-1) & (
                seen[..., 2] > 0.0
            )
    return shown


def _edges_m(surface: Surface, ground: Ground, shift: Array) -> float | None:
    """Return the median distance of the barns' edges in the surface from the true ones [m]; None without barns.

    An edge is where a profile across it passes half of the true height of the roof over the ground.
    """
    misses: list[float] = []
    for corners in ground.barns(*surface.raster.bounds_m):
        for start, end in zip(corners, np.roll(corners, -1, axis=0), strict=True):
            misses += _misses_m(surface, ground, start, end, shift)
    return float(np.median(misses)) if misses else None


def _misses_m(surface: Surface, ground: Ground, start: Array, end: Array, shift: Array) -> list[float]:
    """Return the distances along one edge, a profile every metre; corners are counter-clockwise."""
    length = float(np.linalg.norm(end - start))
    along = (end - start) / length
    outwards = np.array([along[1], -along[0]])
    offsets = np.arange(-REACH_M, REACH_M + 0.5 * STEP_M, STEP_M)
    found = []
    for at in np.arange(CORNER_M, length - CORNER_M, 1.0):
        edge = start + at * along
        inside, outside = edge - INSIDE_M * outwards, edge + OUTSIDE_M * outwards
        roof, floor = (float(ground.height(p[:1], p[1:])[0]) for p in (inside, outside))
        profile = _at(surface, edge + offsets[:, None] * outwards, shift)
        if roof - floor < LEAST_RISE_M or np.isnan(profile).any():
            continue
        high = np.flatnonzero(profile > 0.5 * (roof + floor))
        found.append(abs(float(offsets[high[-1]] + 0.5 * STEP_M)) if len(high) else REACH_M)
    return found


def _at(surface: Surface, points: Array, shift: Array) -> Array:
    """Return the surface's heights at true places, own errors removed; NaN outside."""
    raster = surface.raster
    row, column = (np.rint(index).astype(int) for index in raster.index(points))
    inside = (row >= 0) & (row < raster.rows) & (column >= 0) & (column < raster.columns)
    own = shift[row.clip(0, raster.rows - 1), column.clip(0, raster.columns - 1)]
    row, column = (np.rint(index).astype(int) for index in raster.index(points - own[:, :2]))
    inside &= (row >= 0) & (row < raster.rows) & (column >= 0) & (column < raster.columns)
    heights = surface.height[row.clip(0, raster.rows - 1), column.clip(0, raster.columns - 1)] + own[:, 2]
    return np.where(inside, heights, np.nan)


def _median(errors: Array) -> float | None:
    return float(np.median(np.abs(errors))) if len(errors) else None


def _percentile_95(errors: Array) -> float | None:
    return float(np.percentile(np.abs(errors), 95.0)) if len(errors) else None
