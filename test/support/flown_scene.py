# SPDX-License-Identifier: Apache-2.0
"""A small scene to fly over: any heights and colours, drawn by walking along each ray."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from uav_vslam.geometry.camera import PinholeCamera
from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.rotation import rotation_from_rpy
from uav_vslam.mapping.raster import Raster
from uav_vslam.mapping.view import View

Array = NDArray[np.float64]

R_LEVEL = np.array([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]])  # the image's right is east, its top north
CAMERA = PinholeCamera(320, 240, 320.0, 320.0, 158.3, 121.2)
STEP_M = 0.04  # of height, along a ray


def waves(x: Array, y: Array) -> Array:
    """Return grey levels of a pattern with detail of one metre and more, nowhere alike."""
    a = np.sin(2.1 * x + 0.7 * y + 0.02 * x * x) * np.cos(1.3 * y - 0.9 * x + 0.015 * y * y)
    return np.asarray(125.0 + 40.0 * a + 25.0 * np.sin(0.21 * x - 0.33 * y))


def patches(side_m: float) -> Callable[[Array, Array], Array]:
    """Return a colour: square patches in random grey, 400 each way around the origin."""
    grey = np.random.default_rng(4).uniform(40.0, 200.0, (400, 400))

    def colour(x: Array, y: Array) -> Array:
        column, row = (np.floor(k / side_m).astype(int) + 200 for k in (x, y))
        return np.asarray(grey[np.clip(row, 0, 399), np.clip(column, 0, 399)])

    return colour


@dataclass(frozen=True)
class Scene:
    """Heights [m] and grey or BGR levels over x, y [m]."""

    surface: Callable[[Array, Array], Array] = lambda x, y: np.zeros_like(x)
    colour: Callable[[Array, Array], Array] = waves

    def height(self, raster: Raster) -> NDArray[np.float32]:
        """Return the true heights of a raster."""
        return self.surface(*np.meshgrid(raster.x, raster.y)).astype(np.float32)

    def truth(self, raster: Raster) -> Array:
        """Return the true orthopicture of a raster."""
        return self.colour(*np.meshgrid(raster.x, raster.y))

    def view(
        self,
        position: tuple[float, float, float],
        rpy_deg: tuple[float, float, float] = (0.0, 0.0, 0.0),
        *,
        vehicle: str = "uav1",
        shading: Callable[[Array], Array] = np.ones_like,
        stamp_ns: int = 0,
    ) -> View:
        """Photograph the scene; `shading` gives the brightness at squared radii of the image."""
        R = rotation_from_rpy(*np.deg2rad(rpy_deg)) @ R_LEVEL
        u, v = np.meshgrid(np.arange(CAMERA.width), np.arange(CAMERA.height))
        bearings = CAMERA.bearings(np.stack([u, v], axis=-1))
        x, y = self._hits(np.array(position), bearings @ R.T)
        grey = self.colour(x, y)
        shade = shading((bearings[..., :2] ** 2).sum(axis=-1))
        image = grey * (shade if grey.ndim == 2 else shade[..., None])
        pose = Pose(R, np.array(position))
        return View(vehicle, stamp_ns, CAMERA, pose, np.clip(np.rint(image), 0, 255).astype(np.uint8))

    def _hits(self, origin: Array, rays: Array) -> tuple[Array, Array]:
        """Return x, y where rays first pass below the surface."""
        slope_x, slope_y = rays[..., 0] / -rays[..., 2], rays[..., 1] / -rays[..., 2]
        corners = origin[:2] + origin[2] * np.stack([slope_x.ravel(), slope_y.ravel()], axis=1)
        x, y = np.meshgrid(*(np.arange(corners[:, k].min(), corners[:, k].max(), 0.25) for k in range(2)))
        heights = self.surface(x, y)
        top, bottom = heights.max() + STEP_M, heights.min()
        drop = np.full(slope_x.shape, origin[2] - top)
        for _ in range(int(np.ceil((top - bottom) / STEP_M))):
            above = origin[2] - drop > self.surface(origin[0] + drop * slope_x, origin[1] + drop * slope_y)
            drop = np.where(above, np.minimum(drop + STEP_M, origin[2] - bottom), drop)
        return origin[0] + drop * slope_x, origin[1] + drop * slope_y


def moved(view: View, east_m: float) -> View:
    """Return a view with a pose further east."""
    return replace(view, T_map_cam=Pose(view.T_map_cam.R, view.T_map_cam.t + np.array([east_m, 0.0, 0.0])))
