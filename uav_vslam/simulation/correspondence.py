# SPDX-License-Identifier: Apache-2.0
"""True point correspondences between the rendered images of a simulated flight."""

import numpy as np
from numpy.typing import NDArray

from uav_vslam.geometry.camera import PinholeCamera
from uav_vslam.geometry.pose import Pose
from uav_vslam.simulation.camera_render import intersect, lean_bounds
from uav_vslam.simulation.object_render import Hits
from uav_vslam.simulation.solids import Label
from uav_vslam.simulation.terrain import Ground, Relief

Array = NDArray[np.float64]


def ground_points(pixels: NDArray[np.floating], camera: PinholeCamera, T_world_cam: Pose, relief: Relief) -> Array:
    """Return the (N, 3) ground points [m] seen at (N, 2) raw pixels."""
    rays_world = camera.bearings(camera.undistort(np.asarray(pixels, float))) @ T_world_cam.R.T
    return intersect(relief, T_world_cam.t, rays_world)


def pixels_of(points_world: Array, camera: PinholeCamera, T_world_cam: Pose) -> Array:
    """Return the (N, 2) raw pixels at which (N, 3) ground points project, inside or outside the image."""
    return np.asarray(camera.distort(camera.project(T_world_cam.inverse().apply(points_world))))


def first_hits(ground: Ground, origin: Array, rays: Array) -> tuple[Array, NDArray[np.uint8]]:
    """Return the (..., 3) points [m] that rays see first, of the ground or what stands on it, and their (...) `Label`.

    Args:
        ground: the world.
        origin: (3,) camera centre in the world [m].
        rays: (..., 3) directions in the world, of any length, pointing down.
    """
    points = intersect(ground.relief, origin, rays)
    flat = points.reshape(-1, 3)
    solids = [] if ground.farm is None or len(flat) == 0 else ground.farm.solids(lean_bounds(origin, flat))
    down = (rays / -rays[..., 2:]).reshape(-1, 3)
    hits = Hits.of_ground(origin[2] - flat[:, 2])
    for k, solid in enumerate(solids):
        hits.cast(k, solid, origin, down, np.arange(len(flat)))
    hit = (hits.which >= 0)[:, None]
    labels = np.array([*(solid.label for solid in solids), Label.GROUND], np.uint8)[hits.which]
    return np.where(hit, origin + hits.drop[:, None] * down, flat).reshape(points.shape), labels.reshape(
        rays.shape[:-1]
    )
