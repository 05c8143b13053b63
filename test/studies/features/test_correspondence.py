# SPDX-License-Identifier: Apache-2.0
from dataclasses import replace

import cv2
import numpy as np
import pytest

from uav_vslam.simulation.camera_render import RenderedFlight
from uav_vslam.simulation.scenario import SCENARIOS, SimulatedVehicle, simulate_vehicle
from uav_vslam.simulation.terrain import ground_of
from uav_vslam.studies.features.correspondence import pixels_of, shown_points


@pytest.fixture(scope="module")
def vehicle() -> SimulatedVehicle:
    return simulate_vehicle(replace(SCENARIOS["kagaru"], vehicles=1, frames=3, scale=0.25), 0)


@pytest.fixture
def pixels() -> np.ndarray:
    return np.random.default_rng(1).uniform([20, 60], [300, 220], (200, 2))


def test_points_are_on_the_ground_and_project_back(vehicle: SimulatedVehicle, pixels: np.ndarray) -> None:
    relief, camera = ground_of(vehicle.scenario).relief, vehicle.rig.left
    T_world_cam = vehicle.truth.pose(0.0) @ vehicle.rig.T_body_left
    points = shown_points(pixels, camera, T_world_cam, relief)
    np.testing.assert_allclose(points[:, 2], relief.height(points[:, 0], points[:, 1]), atol=2e-3)
    np.testing.assert_allclose(pixels_of(points, camera, T_world_cam), pixels, atol=1e-6)


def test_corresponding_pixels_of_rendered_images_correlate(vehicle: SimulatedVehicle, pixels: np.ndarray) -> None:
    relief, camera, flight = ground_of(vehicle.scenario).relief, vehicle.rig.left, RenderedFlight(vehicle)
    poses = [vehicle.truth.pose(float(t)) @ vehicle.rig.T_body_left for t in vehicle.frame_times_s]
    there = pixels_of(shown_points(pixels, camera, poses[0], relief), camera, poses[1])
    assert np.linalg.norm(there - pixels, axis=1).min() > 5

    def grey(frame: int, at: np.ndarray) -> np.ndarray:
        image = flight.frame(frame).left.astype(np.float32)
        return cv2.remap(image, *at.astype(np.float32).T[:, :, None], cv2.INTER_LINEAR).ravel()

    assert np.corrcoef(grey(0, pixels), grey(1, there))[0, 1] > 0.9
    assert np.corrcoef(grey(0, pixels), grey(1, there + 4.0))[0, 1] < 0.7


def test_no_pixels_have_no_points(vehicle: SimulatedVehicle) -> None:
    relief, camera = ground_of(vehicle.scenario).relief, vehicle.rig.left
    points = shown_points(np.zeros((0, 2)), camera, vehicle.truth.pose(0.0) @ vehicle.rig.T_body_left, relief)
    assert points.shape == (0, 3)
