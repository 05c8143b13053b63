# SPDX-License-Identifier: Apache-2.0
"""The colour of walls, which the orthomosaic does not show: from the view that looks at each one most directly."""

from collections.abc import Iterable

import cv2
import numpy as np
from numpy.typing import NDArray

from uav_vslam.mapping.model.triangles import Mesh
from uav_vslam.mapping.raster import Raster
from uav_vslam.mapping.view import View

Array = NDArray[np.float64]

UNSEEN_SHADE = 0.7  # brightness over what is above it, of a wall that no view shows
START_M = 0.6  # from a wall, where rays to the camera begin: heights next to a wall are uncertain
STEP_M = 0.25
REACH_M = 15.0  # along the ground, within which something may stand in the way
TOLERANCE_M = 0.3
LEAST_COSINE = 0.05


def wall_colours(
    walls: Mesh, above: Array, views: Iterable[View], heights: NDArray[np.float32], raster: Raster
) -> Array:
    """Return (F, 3) BGR colours of the walls' faces.

    Args:
        walls: steep faces.
        above: (F, 3) BGR of the ground or roof at each face, for those that no view shows.
        views: to choose from.
        heights: (rows, columns) of the surface [m], NaN where unknown.
        raster: their window.
    """
    centres = walls.vertices[walls.faces].mean(axis=1)
    normals = walls.normals
    best = np.full(len(centres), LEAST_COSINE)
    colours = above * UNSEEN_SHADE
    for view in views:
        pixels, cosine = _shown(view, centres, normals)
        better = np.flatnonzero(cosine > best)
        free = _free(centres[better] + START_M * normals[better], view.T_map_cam.t, heights, raster)
        chosen = better[free]
        best[chosen] = cosine[chosen]
        colours[chosen] = _sampled(view, pixels[chosen])
    return np.asarray(colours)


def _shown(view: View, points: Array, normals: Array) -> tuple[Array, Array]:
    """Return (F, 2) pixels and the cosine of the angle of sight, 0 outside the image."""
    towards = view.T_map_cam.t - points
    cosine = (towards * normals).sum(axis=1) / np.linalg.norm(towards, axis=1)
    points_cam = view.T_map_cam.inverse().apply(points)
    ahead = points_cam[:, 2] > 0
    points_cam[~ahead] = [0.0, 0.0, 1.0]
    pixels = view.camera.project(points_cam)
    inside = ahead & (pixels > 1).all(axis=1) & (pixels < [view.camera.width - 2, view.camera.height - 2]).all(axis=1)
    return pixels, np.where(inside, cosine, 0.0)


def _free(points: Array, camera: Array, heights: NDArray[np.float32], raster: Raster) -> NDArray[np.bool_]:
    """Return whether nothing stands between (N, 3) points and the camera."""
    level = np.pad(np.where(np.isfinite(heights), heights, np.float32(-1e9)), 1, constant_values=-1e9)
    towards = camera - points
    away = np.maximum(np.linalg.norm(towards[:, :2], axis=1, keepdims=True), 1e-6)
    free = np.ones(len(points), bool)
    for distance_m in np.arange(STEP_M, REACH_M, STEP_M):
        ray = points + towards / away * np.minimum(distance_m, away)
        row, column = (np.rint(k).astype(int) + 1 for k in raster.index(ray))
        met = level[np.clip(row, 0, raster.rows + 1), np.clip(column, 0, raster.columns + 1)]
        free &= ray[:, 2] > met - TOLERANCE_M
    return free


def _sampled(view: View, pixels: Array) -> Array:
    """Return (N, 3) BGR at (N, 2) pixels, averaged over their surroundings."""
    if len(pixels) == 0:
        return np.zeros((0, 3))
    image = cv2.blur(view.image, (5, 5))
    u, v = np.rint(pixels).astype(int).T
    found = image[v, u].astype(float)
    return np.asarray(np.repeat(found[:, None], 3, axis=1) if found.ndim == 1 else found)
