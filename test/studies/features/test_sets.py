# SPDX-License-Identifier: Apache-2.0
from dataclasses import replace

import cv2
import numpy as np
import pytest

from uav_vslam.simulation.camera_render import RenderedFlight
from uav_vslam.simulation.scenario import SCENARIOS, SimulatedVehicle, simulate_vehicle
from uav_vslam.simulation.terrain import ground_of
from uav_vslam.studies.engine.extracted_flights import ground_points
from uav_vslam.studies.features.sets import View, flown

FIRST, SECOND = (View("flight", "rendered", number, str(number), np.zeros((1, 1))) for number in range(2))


@pytest.fixture(scope="module")
def vehicle() -> SimulatedVehicle:
    return simulate_vehicle(replace(SCENARIOS["kagaru"], vehicles=1, frames=3, scale=0.25), 0)


@pytest.fixture
def pixels() -> np.ndarray:
    return np.random.default_rng(1).uniform([20, 60], [300, 220], (200, 2))


def test_points_are_on_the_ground_and_project_back(vehicle: SimulatedVehicle, pixels: np.ndarray) -> None:
    relief, camera = ground_of(vehicle.scenario).relief, vehicle.rig.left
    T_world_cam = vehicle.truth.pose(0.0) @ vehicle.rig.T_body_left
    points = ground_points(relief, T_world_cam, camera, camera.undistort(pixels))
    np.testing.assert_allclose(points[:, 2], relief.height(points[:, 0], points[:, 1]), atol=2e-3)
    np.testing.assert_allclose(flown(vehicle, vehicle.scenario)(FIRST, FIRST, pixels), pixels, atol=1e-6)


def test_corresponding_pixels_of_rendered_images_correlate(vehicle: SimulatedVehicle, pixels: np.ndarray) -> None:
    flight, there = RenderedFlight(vehicle), flown(vehicle, vehicle.scenario)(FIRST, SECOND, pixels)
    assert np.linalg.norm(there - pixels, axis=1).min() > 5

    def grey(frame: int, at: np.ndarray) -> np.ndarray:
        image = flight.frame(frame).left.astype(np.float32)
        return cv2.remap(image, *at.astype(np.float32).T[:, :, None], cv2.INTER_LINEAR).ravel()

    assert np.corrcoef(grey(0, pixels), grey(1, there))[0, 1] > 0.9
    assert np.corrcoef(grey(0, pixels), grey(1, there + 4.0))[0, 1] < 0.7


def test_no_pixels_have_no_points(vehicle: SimulatedVehicle) -> None:
    assert flown(vehicle, vehicle.scenario)(FIRST, SECOND, np.zeros((0, 2))).shape == (0, 2)
