# SPDX-License-Identifier: Apache-2.0
"""True point correspondences between the rendered images of a simulated flight."""

import numpy as np
from numpy.typing import NDArray

from uav_vslam.geometry.camera import PinholeCamera
from uav_vslam.geometry.pose import Pose
from uav_vslam.simulation.terrain import Relief
from uav_vslam.studies.engine.extracted_flights import ground_points

Array = NDArray[np.float64]


def shown_points(pixels: NDArray[np.floating], camera: PinholeCamera, T_world_cam: Pose, relief: Relief) -> Array:
    """Return the (N, 3) ground points [m] seen at (N, 2) raw pixels."""
    return ground_points(relief, T_world_cam, camera, camera.undistort(pixels))


def pixels_of(points_world: Array, camera: PinholeCamera, T_world_cam: Pose) -> Array:
    """Return the (N, 2) raw pixels at which (N, 3) ground points project, inside or outside the image."""
    return np.asarray(camera.distort(camera.project(T_world_cam.inverse().apply(points_world))))
