# SPDX-License-Identifier: Apache-2.0
"""How many pictures see each place of the ground."""

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from uav_vslam.geometry.camera import PinholeCamera
from uav_vslam.geometry.pose import Pose
from uav_vslam.mapping.pictures.lens import fold_radius
from uav_vslam.mapping.pictures.surface import PointSurface


def view_counts(surface: PointSurface, cameras: Iterable[tuple[PinholeCamera, Pose]]) -> NDArray[np.uint16]:
    """Return (rows, columns) numbers of cameras, with poses T_map_cam, that see each cell of the surface's window.

    Args:
        surface: of the ground.
        cameras: with radial distortion, as `lens.camera_of` returns them.
    """
    x, y = np.meshgrid(surface.raster.x, surface.raster.y)
    ground = np.stack([x, y, surface.grid], axis=-1)
    counts = np.zeros(surface.raster.shape, np.uint16)
    for camera, T_map_cam in cameras:
        counts += _seen(camera, T_map_cam.inverse().apply(ground))
    return counts


def _seen(camera: PinholeCamera, points_cam: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return (rows, columns) whether a camera images (rows, columns, 3) points within its picture."""
    before = points_cam[..., 2] > 0.0
    ideal = camera.project(np.where(before[..., None], points_cam, np.nan))
    rays = camera.bearings(ideal)
    before &= np.hypot(rays[..., 0], rays[..., 1]) < fold_radius(*camera.distortion[:2])
    pixels = camera.distort(ideal)
    inside = (pixels >= 0.0) & (pixels <= [camera.width - 1, camera.height - 1])
    return np.asarray(before & inside.all(axis=-1))
