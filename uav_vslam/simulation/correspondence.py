# SPDX-License-Identifier: Apache-2.0
"""Where a point of one rendered image lies in another: every true correspondence of a simulated flight."""

import numpy as np
from numpy.typing import NDArray

from uav_vslam.geometry.camera import PinholeCamera
from uav_vslam.geometry.pose import Pose
from uav_vslam.simulation.camera_render import intersect
from uav_vslam.simulation.terrain import Relief

Array = NDArray[np.float64]


def ground_points(pixels: NDArray[np.floating], camera: PinholeCamera, T_world_cam: Pose, relief: Relief) -> Array:
    """Return the (N, 3) places on the ground [m] that (N, 2) raw pixels show."""
    rays_world = camera.bearings(camera.undistort(np.asarray(pixels, float))) @ T_world_cam.R.T
    return intersect(relief, T_world_cam.t, rays_world)


def pixels_of(points_world: Array, camera: PinholeCamera, T_world_cam: Pose) -> Array:
    """Return the (N, 2) raw pixels where (N, 3) places on the ground are seen, inside the image or beside it."""
    return np.asarray(camera.distort(camera.project(T_world_cam.inverse().apply(points_world))))
