# SPDX-License-Identifier: Apache-2.0
"""Rendered pixels are where the true pose projects the ground."""

import dataclasses
import itertools

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from uav_vslam.geometry.pose import Pose
from uav_vslam.simulation.camera_render import CameraRenderer, RenderedFlight, intersect, motion_kernel
from uav_vslam.simulation.rig import kagaru_rig
from uav_vslam.simulation.scenario import SCENARIOS, SimulatedVehicle, simulate_vehicle
from uav_vslam.simulation.terrain import Ground, Relief, ground_of

FEATURE_PX = 0.03  # distance of a texture spot from its projection (0.01 at full resolution)
DISPARITY_BIAS_PX = 0.02
BLOB_SPACING_M = 6.0
SMALL = dataclasses.replace(SCENARIOS["kagaru"], frames=8, scale=0.5)


class Blobs:
    """Bright Gaussian spots of 20 cm on a square lattice."""

    m_per_px = 0.05

    def window(self, x0: int, y0: int, x1: int, y1: int) -> NDArray[np.uint8]:
        x, y = (np.arange(a, b) * self.m_per_px for a, b in ((x0, x1), (y0, y1)))
        dx, dy = (a - BLOB_SPACING_M * np.rint(a / BLOB_SPACING_M) for a in (x, y))
        spot = np.exp(-0.5 * (dy[:, None] ** 2 + dx**2) / 0.2**2)
        return np.rint(30.0 + 200.0 * spot).astype(np.uint8)


def blob_centres(relief: Relief, around: NDArray[np.float64]) -> NDArray[np.float64]:
    near = BLOB_SPACING_M * np.rint(around[:2] / BLOB_SPACING_M)
    steps = BLOB_SPACING_M * np.arange(-3, 4)
    xy = near + np.array(list(itertools.product(steps, steps)))
    return np.column_stack([xy, relief.height(xy[:, 0], xy[:, 1])])


def centroid(image: NDArray[np.float32], pixel: NDArray[np.float64], half: int = 16) -> NDArray[np.float64] | None:
    u, v = np.rint(pixel).astype(int)
    if not (half <= u < image.shape[1] - half and half <= v < image.shape[0] - half):
        return None
    patch = image[v - half : v + half + 1, u - half : u + half + 1].astype(float)
    weight = np.maximum(patch - 40.0, 0.0)
    offsets = np.arange(-half, half + 1)
    return np.array([u + (weight.sum(0) @ offsets) / weight.sum(), v + (weight.sum(1) @ offsets) / weight.sum()])


@pytest.mark.parametrize("scale", [1.0, 0.5, 0.375])
def test_a_known_ground_point_is_rendered_where_the_rig_projects_it(scale: float) -> None:
    vehicle = simulate_vehicle(dataclasses.replace(SCENARIOS["kagaru"], scale=scale), 0)
    relief = Relief(2.0, np.random.default_rng(4))
    rig, T_world_body = vehicle.rig, vehicle.truth.pose(9.0)
    centres = blob_centres(relief, T_world_body.t)
    errors, disparity_errors = [], []
    expected = rig.project((T_world_body @ rig.T_body_left).inverse().apply(centres))
    images = [
        CameraRenderer(camera, Ground(relief, Blobs()), supersample=round(1.0 / scale)).render(
            T_world_body @ T_body_cam
        )
        for camera, T_body_cam in ((rig.left, rig.T_body_left), (rig.right, rig.T_body_right))
    ]
    half = round(16 * scale)
    for pixels in expected:
        left, right = centroid(images[0], pixels[:2], half), centroid(images[1], pixels[2:], half)
        if left is not None and right is not None:
            found = np.concatenate([left, right])
            errors.append(found - pixels)
            disparity_errors.append((left - right) - (pixels[:2] - pixels[2:]))
    assert len(errors) > 20
    assert np.abs(errors).max() < FEATURE_PX
    assert np.abs(np.mean(disparity_errors, axis=0)).max() < DISPARITY_BIAS_PX


def test_disparity_of_tracked_grass_has_no_bias() -> None:
    vehicle = simulate_vehicle(SCENARIOS["kagaru"], 0)
    ground = ground_of(vehicle.scenario)
    frame = RenderedFlight(vehicle, ground).frame(40)
    T_world_left = vehicle.truth.pose(float(vehicle.frame_times_s[40])) @ vehicle.rig.T_body_left
    left = np.array(list(itertools.product(np.arange(100.0, 1200.0, 40.0), np.arange(100.0, 900.0, 40.0))))
    points = intersect(ground.relief, T_world_left.t, vehicle.rig.left.bearings(left) @ T_world_left.R.T)
    true_right = vehicle.rig.project(T_world_left.inverse().apply(points))[:, 2:]
    start = true_right.astype(np.float32)
    right, status, _ = cv2.calcOpticalFlowPyrLK(
        frame.left, frame.right, left.astype(np.float32), start, winSize=(21, 21), maxLevel=0, flags=4
    )
    error = (right - true_right)[status.ravel() == 1]
    assert len(error) > 300
    assert np.abs(np.median(error, axis=0)).max() < DISPARITY_BIAS_PX
    assert np.abs(np.mean(error, axis=0)).max() < DISPARITY_BIAS_PX
    assert error.std() < 0.2


def test_rays_meet_the_ground_within_a_millimetre() -> None:
    relief = Relief(3.0, np.random.default_rng(2))
    origin = np.array([12.0, -7.0, 70.0])
    rays = np.random.default_rng(0).uniform([-0.6, -0.6, -1.0], [0.6, 0.6, -0.9], (500, 3))
    points = intersect(relief, origin, rays)
    np.testing.assert_allclose(relief.height(points[:, 0], points[:, 1]), points[:, 2], atol=2e-3)
    np.testing.assert_allclose(np.cross(points - origin, rays), 0.0, atol=1e-6)


def test_one_pixel_of_motion_blurs_by_one_six_one() -> None:
    np.testing.assert_allclose(motion_kernel(0.0, 1.0)[:, 2], np.array([0, 1, 6, 1, 0]) / 8.0, atol=2e-3)
    np.testing.assert_allclose(motion_kernel(0.0, 0.0)[1], [0.0, 1.0, 0.0], atol=1e-6)
    for blur in ((1.0, 2.0), (-3.0, 0.5)):
        assert motion_kernel(*blur).sum() == pytest.approx(1.0, abs=1e-6)


def test_image_motion_is_forward_flight_seen_from_above() -> None:
    rig = kagaru_rig()
    renderer = CameraRenderer(rig.left, Ground(Relief(0.0, np.random.default_rng(0)), Blobs()))
    before = Pose(np.eye(3), np.array([0.0, 0.0, 70.1])) @ rig.T_body_left
    after = Pose(np.eye(3), np.array([0.02, 0.0, 70.1])) @ rig.T_body_left
    motion = renderer.image_motion(before, after)
    np.testing.assert_allclose(motion, [0.0, 1642.3 * 0.02 / 70.0], atol=1e-3)  # the ground moves down the image


def test_frames_do_not_depend_on_the_rendering_order() -> None:
    vehicle = simulate_vehicle(SMALL, 0)
    in_order = [f.left.tobytes() + f.right.tobytes() for f in RenderedFlight(vehicle)]
    backwards = RenderedFlight(vehicle)
    for k in (7, 3, 0):
        frame = backwards.frame(k)
        assert frame.left.tobytes() + frame.right.tobytes() == in_order[k]


def test_gain_and_vignette_darken_the_right_image_only() -> None:
    def means(vehicle: SimulatedVehicle) -> tuple[float, float, float]:
        frame = RenderedFlight(vehicle).frame(0)
        return float(frame.left.mean()), float(frame.right.mean()), float(frame.right[:40, :40].mean())

    plain = means(simulate_vehicle(SMALL, 0))
    dim = means(simulate_vehicle(dataclasses.replace(SMALL, right_gain=0.8, right_vignette=0.5), 0))
    assert dim[0] == plain[0]
    assert dim[1] == pytest.approx(plain[1] * 0.8 * (1.0 - 0.5 / 3.0), rel=0.03)
    assert dim[2] < 0.55 * plain[2]


def test_reduced_contrast_moves_all_greys_towards_the_mean() -> None:
    clear, faded = (
        RenderedFlight(simulate_vehicle(dataclasses.replace(SMALL, noise_sigma=0.0, contrast=contrast), 0)).frame(2)
        for contrast in (1.0, 0.25)
    )
    expected = 128.0 + 0.25 * (clear.left.astype(float) - 128.0)
    assert np.abs(faded.left - expected).max() <= 0.25 * 0.5 + 0.5 + 1e-3  # both are rounded to whole greys
    assert faded.right.std() == pytest.approx(0.25 * clear.right.std(), rel=0.05)
