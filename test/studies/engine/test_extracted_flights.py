# SPDX-License-Identifier: Apache-2.0
"""Where a true flight's pixels are on the ground."""

import numpy as np

from uav_vslam.simulation.landmarks import scatter_landmarks
from uav_vslam.simulation.scenario import Scenario, simulate_vehicle
from uav_vslam.simulation.terrain import relief_of
from uav_vslam.studies.engine.extracted_flights import ground_points, shown_at


def test_pixels_are_traced_to_the_points_that_they_show() -> None:
    scenario = Scenario(vehicles=1, frames=3)
    vehicle = simulate_vehicle(scenario, 0)
    points = scatter_landmarks([vehicle]).points_world
    T_world_left = vehicle.truth.pose(float(vehicle.frame_times_s[2])) @ vehicle.rig.T_body_left
    near = points[np.linalg.norm(points[:, :2] - vehicle.truth.position(0.0)[:2], axis=1) < 20.0]
    pixels = shown_at(T_world_left, vehicle.rig.left, near).astype(np.float32)
    traced = ground_points(relief_of(scenario), T_world_left, vehicle.rig.left, pixels)
    np.testing.assert_allclose(traced, near, atol=0.01)
