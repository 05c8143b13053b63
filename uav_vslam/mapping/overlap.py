# SPDX-License-Identifier: Apache-2.0
"""How many views show each cell, by projection of its height; what hides it is not considered."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from uav_vslam.geometry.camera import PinholeCamera
from uav_vslam.geometry.pose import Pose
from uav_vslam.mapping.image_border import image_border
from uav_vslam.mapping.raster import Raster
from uav_vslam.mapping.surface.grid import HeightGrid
from uav_vslam.mapping.view import View

Array = NDArray[np.float64]

MOST_VIEWS = np.iinfo(np.uint16).max  # that are counted
EDGE_POINTS = 5  # of each side of an image
HEIGHT_STEPS = 3  # fixed-point steps from the ray to the surface
FLATTEST_RAY = 0.2  # least fall of a ray of depth one; flatter ones are cut


@dataclass(slots=True)
class Overlap:
    """The views of a map.

    Attributes:
        views: camera and pose of each.
    """

    views: list[tuple[PinholeCamera, Pose]] = field(default_factory=list)

    def add(self, view: View) -> None:
        """Note where a view was taken."""
        self.views.append((view.camera, view.T_map_cam))

    def count(self, grid: HeightGrid) -> tuple[Raster, NDArray[np.uint16]]:
        """Return how many views show each cell of the smallest window that holds the grid's and all that they show.

        Returns:
            The window, and (rows, columns) numbers of views, `MOST_VIEWS` at most.
        """
        known = grid.extent
        if not self.views or known.rows == 0:
            return known, np.zeros(known.shape, np.uint16)
        level, ground_m = _without_gaps(grid.height(known))
        seen = [footprint(camera, pose, level, known, ground_m=ground_m) for camera, pose in self.views]
        window = known.union(Raster.covering(np.vstack(seen), grid.cell_m))
        height = np.full(window.shape, ground_m, np.float32)
        height[known.within(window)] = level
        count = np.zeros(window.shape, np.uint16)
        for camera, pose in self.views:
            outline = Raster.covering(footprint(camera, pose, height, window, ground_m=ground_m), grid.cell_m)
            part = outline.intersection(window)
            cut = part.within(window)
            count[cut] += _shown(camera, pose, part, height[cut]) & (count[cut] < MOST_VIEWS)
        return window, count

    def gsd_m(self, ground_m: float) -> float:
        """Return the median size of a pixel on ground of a height [m]; NaN without views."""
        if not self.views:
            return float("nan")
        return float(np.median([(pose.t[2] - ground_m) / camera.fx for camera, pose in self.views]))


def _without_gaps(height: NDArray[np.float32]) -> tuple[NDArray[np.float32], float]:
    """Put the median height where none is known, and return the array and that height [m]."""
    unknown = np.isnan(height)
    median = np.float32(0.0) if unknown.all() else np.median(height[~unknown])
    height[unknown] = median
    return height, float(median)


def _shown(camera: PinholeCamera, T_map_cam: Pose, raster: Raster, height: NDArray[np.floating]) -> NDArray[np.bool_]:
    """Return whether a camera shows each cell of a window, (rows, columns)."""
    x, y = np.meshgrid(raster.x, raster.y)
    points = T_map_cam.inverse().apply(np.stack([x, y, height], axis=-1))
    before = points[..., 2] > 0.0
    points[~before] = [0.0, 0.0, 1.0]
    pixels = camera.project(points)
    inside = (pixels >= -0.5) & (pixels <= [camera.width - 0.5, camera.height - 0.5])
    return np.asarray(before & inside.all(axis=-1))


def footprint(
    camera: PinholeCamera, T_map_cam: Pose, height: NDArray[np.floating], raster: Raster, *, ground_m: float
) -> Array:
    """Return the (N, 2) outline of what a camera sees of a surface [m].

    Args:
        camera: without distortion.
        T_map_cam: pose.
        height: (rows, columns) surface over the window [m], without gaps; beyond its edge it goes on level.
        raster: the window.
        ground_m: its median height, with which the steps begin [m].
    """
    rays = camera.bearings(image_border(camera, EDGE_POINTS)) @ T_map_cam.R.T
    fall = np.maximum(-rays[:, 2], FLATTEST_RAY)
    ground = np.full(len(rays), ground_m)
    for _ in range(HEIGHT_STEPS + 1):
        points = T_map_cam.t[:2] + ((T_map_cam.t[2] - ground) / fall)[:, None] * rays[:, :2]
        row, column = (np.rint(index).astype(int) for index in raster.index(points))
        ground = height[row.clip(0, raster.rows - 1), column.clip(0, raster.columns - 1)]
    return np.asarray(points)
