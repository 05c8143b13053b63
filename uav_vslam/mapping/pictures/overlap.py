# SPDX-License-Identifier: Apache-2.0
"""How many pictures see each place of the ground."""

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from uav_vslam.geometry.camera import PinholeCamera
from uav_vslam.geometry.pose import Pose
from uav_vslam.mapping.pictures.surface import PointSurface


def view_counts(surface: PointSurface, cameras: Iterable[tuple[PinholeCamera, Pose]]) -> NDArray[np.uint16]:
    """Return (rows, columns) numbers of cameras, with poses T_map_cam, that see each cell of the surface's window."""
    x, y = np.meshgrid(surface.raster.x, surface.raster.y)
    ground = np.stack([x, y, surface.grid], axis=-1)
    counts = np.zeros(surface.raster.shape, np.uint16)
    for camera, T_map_cam in cameras:
        inside = T_map_cam.inverse().apply(ground)
        inside[..., 2] = np.where(inside[..., 2] > 0.0, inside[..., 2], np.nan)
        pixels = camera.project(inside)
        counts += ((pixels >= 0.0) & (pixels <= [camera.width - 1, camera.height - 1])).all(axis=-1)
    return counts
