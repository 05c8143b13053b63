# SPDX-License-Identifier: Apache-2.0
"""Which part of the ground a view can show."""

import cv2
import numpy as np
from numpy.typing import NDArray

from uav_vslam.geometry.camera import PinholeCamera
from uav_vslam.geometry.pose import Pose
from uav_vslam.mapping.image_border import image_border
from uav_vslam.mapping.orthomosaic.heights import Heights
from uav_vslam.mapping.raster import Raster

Array = NDArray[np.float64]

LARGEST_TANGENT = 1.7  # of the angle from the vertical at which ground is still shown, 60 degrees
BORDER_RAYS = 3  # along each side of the image
LOOK_CELL_M = 2.0  # heights are looked at this coarsely to find the footprint


def outline(camera: PinholeCamera, T_map_cam: Pose, height_m: float) -> Array:
    """Return the (N, 2) outline x, y [m] of the image on a level plane.

    Rays flatter than `LARGEST_TANGENT` end there, so that an oblique view has a bounded footprint.
    """
    rays_map = camera.bearings(image_border(camera, BORDER_RAYS)) @ T_map_cam.R.T
    tangents = rays_map[:, :2] / np.maximum(-rays_map[:, 2:], 1e-6)
    lengths = np.linalg.norm(tangents, axis=1, keepdims=True)
    tangents *= np.minimum(1.0, LARGEST_TANGENT / np.maximum(lengths, 1e-12))
    return np.asarray(T_map_cam.t[:2] + tangents * (T_map_cam.t[2] - height_m))


def overlap(first: Array, second: Array) -> float:
    """Return the share of the first of two convex outlines, (N, 2) and (M, 2) [m], that the second one covers."""
    a, b = first.astype(np.float32), second.astype(np.float32)
    common, _ = cv2.intersectConvexConvex(cv2.convexHull(a), cv2.convexHull(b))
    return float(common / max(cv2.contourArea(cv2.convexHull(a)), 1e-9))


def footprint(camera: PinholeCamera, T_map_cam: Pose, surface: Heights, cell_m: float) -> Raster:
    """Return the window of cells that the view may show; empty where the surface is unknown under it."""
    below = Raster.covering(T_map_cam.t[None, :2], 10.0 * LOOK_CELL_M)
    level = _known(surface.height(below.with_cells(LOOK_CELL_M)))
    if len(level) == 0:
        level = np.array([0.0])
    seen = Raster.covering(outline(camera, T_map_cam, float(np.median(level))), LOOK_CELL_M)
    heights = _known(surface.height(seen))
    heights = heights[heights < T_map_cam.t[2]]
    if len(heights) == 0:
        return Raster(cell_m, 0, 0, 0, 0)
    low, high = (outline(camera, T_map_cam, float(h)) for h in (heights.min(), heights.max()))
    return Raster.covering(np.concatenate([low, high]), cell_m)


def _known(heights: NDArray[np.float32]) -> NDArray[np.float32]:
    return np.asarray(heights[np.isfinite(heights)])
