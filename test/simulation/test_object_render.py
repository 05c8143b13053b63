# SPDX-License-Identifier: Apache-2.0
"""What stands on the ground is rendered where the camera projects it, in both cameras, grey and in colour."""

import dataclasses
import itertools

import cv2
import numpy as np
import pytest
from first_hits import first_hits
from numpy.typing import NDArray
from ridged_roof import roof_corners

from uav_vslam.geometry.camera import PinholeCamera
from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.rotation import so3_exp
from uav_vslam.simulation.camera_render import CameraRenderer, RenderedFlight
from uav_vslam.simulation.object_render import SAMPLES, SolidPainter, pixel_samples
from uav_vslam.simulation.ridged import Ridged
from uav_vslam.simulation.rig import R_BODY_OPTICAL, kagaru_rig
from uav_vslam.simulation.scenario import SCENARIOS, simulate_vehicle
from uav_vslam.simulation.shading import LUMINANCE
from uav_vslam.simulation.solids import Label
from uav_vslam.simulation.terrain import Ground, ground_of

Array = NDArray[np.float64]
Image = NDArray[np.float32]

FARM = dataclasses.replace(SCENARIOS["kagaru"], seed=3, objects=True, frames=6, scale=0.5)
CORNER_PX = 0.2
DISPARITY_PX = 0.1  # of the mean of a barn's corners
RIG = kagaru_rig()


@pytest.fixture(scope="module")
def ground() -> Ground:
    return ground_of(FARM)


def barn(heading: float) -> Ridged:
    return Ridged(Label.BARN, 5, -3.0, 0.0, 0.0, heading, 13.0, 9.0, 7.0, pitch=0.7)


def coverage(camera: PinholeCamera, T_world_cam: Pose, solid: Ridged) -> Image:
    """Return the share of each pixel that a solid on a plane z = 0 covers, from images over black and white ground."""
    shape = camera.height, camera.width
    painter = SolidPainter(camera, T_world_cam, [solid])
    black, white = (
        painter.draw(np.full(shape, grey, np.float32), np.full(shape, T_world_cam.t[2])) for grey in (0.0, 100.0)
    )
    return 1.0 - (white - black) / np.float32(100.0)


def fitted_edge(covered: Image, start: Array, end: Array) -> tuple[Array, Array]:
    """Return a point and the direction of the edge near the line from start to end."""
    along = (end - start) / np.linalg.norm(end - start)
    normal = np.array([-along[1], along[0]])
    at, off = np.linspace(0.1, 0.9, 200), np.arange(-4.0, 4.001, 0.05)
    grid = (start + at[:, None, None] * (end - start) + off[:, None] * normal).astype(np.float32)
    across = cv2.remap(covered, grid[..., 0], grid[..., 1], cv2.INTER_LINEAR).astype(float)
    assert across[:, 0].max() == 0.0  # outside
    assert across[:, -1].min() == 1.0
    edge = off[-1] - np.trapezoid(across, off, axis=1)
    slope, offset = np.polyfit(at * np.linalg.norm(end - start), edge, 1)
    return start + offset * normal, along + slope * normal


def fitted_corners(covered: Image, corners: Array) -> Array:
    """Return the (N, 2) corners of the outline that is near a polygon of (N, 2) corners."""
    edges = [fitted_edge(covered, corners[k], corners[(k + 1) % len(corners)]) for k in range(len(corners))]
    found = []
    for (p, d), (q, e) in zip(edges[-1:] + edges[:-1], edges, strict=True):
        t = np.linalg.solve(np.column_stack([d, -e]), q - p)[0]
        found.append(p + t * d)
    return np.array(found)


def roof_outline(solid: Ridged) -> Array:
    """Return the (6, 3) corners of a roof clockwise in an image from above; the roof hides the walls there."""
    return roof_corners(solid)[[0, 4, 3, 2, 5, 1]]


@pytest.mark.parametrize(("heading", "tilt"), [(0.0, 0.0), (0.4, 0.03), (1.2, -0.03)])
def test_a_barns_corners_are_rendered_where_both_cameras_project_them(heading: float, tilt: float) -> None:
    solid = barn(heading)
    T_world_body = Pose(so3_exp(np.array([tilt, 0.5 * tilt, 0.1])), np.array([0.0, 0.0, 70.0]))
    errors = []
    for camera, T_body_cam in ((RIG.left, RIG.T_body_left), (RIG.right, RIG.T_body_right)):
        T_world_cam = T_world_body @ T_body_cam
        expected = camera.project(T_world_cam.inverse().apply(roof_outline(solid)))
        errors.append(fitted_corners(coverage(camera, T_world_cam, solid), expected) - expected)
    assert np.abs(errors).max() < CORNER_PX
    assert np.abs(np.mean(errors[0] - errors[1], axis=0)).max() < DISPARITY_PX


def test_a_lens_bends_a_barn_as_its_model_says() -> None:
    lens = dataclasses.replace(RIG.left, distortion=np.array([-0.2, 0.05, 1e-3, -1e-3, 0.0]))
    T_world_cam = Pose(R_BODY_OPTICAL.copy(), np.array([8.0, 6.0, 60.0]))
    solid = dataclasses.replace(barn(0.3), ridge_z=1.0, pitch=0.0)
    bent, straight = (coverage(camera, T_world_cam, solid) > 0.5 for camera in (lens, RIG.left))
    inside = np.argwhere(cv2.erode(bent.astype(np.uint8), np.ones((5, 5), np.uint8)))[::50, ::-1]
    outside = np.argwhere(cv2.dilate(bent.astype(np.uint8), np.ones((5, 5), np.uint8)) == 0)[::50, ::-1]
    for pixels, value in ((inside, True), (outside, False)):
        ideal = np.rint(lens.undistort(pixels.astype(float))).astype(int)
        ideal = ideal[(ideal >= 0).all(axis=1) & (ideal < [lens.width, lens.height]).all(axis=1)]
        assert len(ideal) > 100
        assert (straight[ideal[:, 1], ideal[:, 0]] == value).all()
    assert (bent != straight).sum() > 1000


@pytest.mark.parametrize("roll", [0.0, 0.3, -0.3])
def test_images_show_the_true_picture_at_the_points_that_rays_meet(ground: Ground, roll: float) -> None:
    camera = kagaru_rig(0.5).left
    T_world_cam = Pose(so3_exp(np.array([roll, 0.1, 0.4])), np.array([50.0, -30.0, 70.0])) @ RIG.T_body_left
    image = CameraRenderer(camera, ground, supersample=2).render(T_world_cam)
    pixels = np.stack(np.meshgrid(np.arange(10, camera.width, 9), np.arange(10, camera.height, 9)), axis=-1)
    rays = camera.bearings(pixels.astype(float)) @ T_world_cam.R.T
    points, labels = first_hits(ground, T_world_cam.t, rays)
    top = np.abs(ground.height(points[..., 0], points[..., 1]) - points[..., 2]) < 5e-3
    error = image[pixels[..., 1], pixels[..., 0]] - ground.grey(points[..., 0], points[..., 1])
    assert top.mean() > 0.9
    for label in (Label.GROUND, Label.BARN, Label.HEDGE):
        chosen = error[top & (labels == label)]
        assert len(chosen) > 20
        assert abs(np.median(chosen)) < 2.0
        assert np.median(np.abs(chosen)) < 6.0  # an image at half size blurs the texture
    walls = ~top & (labels == Label.BARN)
    assert roll == 0.0 or walls.sum() > 5


def test_grey_images_are_the_luminance_of_coloured_ones(ground: Ground) -> None:
    vehicle = simulate_vehicle(dataclasses.replace(FARM, noise_sigma=0.0), 0)
    pose = vehicle.truth.pose(0.5) @ vehicle.rig.T_body_left
    grey, colour = (
        CameraRenderer(vehicle.rig.left, ground, supersample=2, colour=colour).render(pose) for colour in (False, True)
    )
    assert colour.shape == (*grey.shape, 3)
    np.testing.assert_allclose(colour @ LUMINANCE, grey, atol=1.0)  # texels of both are rounded


@pytest.mark.slow
def test_a_flight_over_objects_is_the_same_in_any_order_and_any_company(ground: Ground) -> None:
    vehicle = simulate_vehicle(dataclasses.replace(FARM, colour=True), 0)
    one, other = RenderedFlight(vehicle, ground), RenderedFlight(vehicle)
    for k in (5, 0):
        frame, again = one.frame(k), other.frame(k)
        assert frame.left.shape == (480, 640, 3)
        assert frame.left.dtype == np.uint8
        np.testing.assert_array_equal(frame.left, again.left)
        np.testing.assert_array_equal(frame.right, again.right)


def test_objects_and_colour_change_nothing_but_the_images() -> None:
    plain = simulate_vehicle(dataclasses.replace(FARM, objects=False), 0)
    rich = simulate_vehicle(dataclasses.replace(FARM, colour=True), 0)
    np.testing.assert_array_equal(plain.imu.gyro, rich.imu.gyro)
    np.testing.assert_array_equal(plain.imu.accel, rich.imu.accel)
    np.testing.assert_array_equal(plain.initial.state.T_map_body.t, rich.initial.state.T_map_body.t)
    x, y = np.random.default_rng(0).uniform(-200.0, 200.0, (2, 100))
    np.testing.assert_array_equal(
        ground_of(plain.scenario).relief.height(x, y), ground_of(rich.scenario).relief.height(x, y)
    )


def test_colour_without_objects_keeps_the_grey_texture() -> None:
    vehicle = simulate_vehicle(dataclasses.replace(FARM, objects=False, colour=True, noise_sigma=0.0), 0)
    grey = RenderedFlight(simulate_vehicle(dataclasses.replace(vehicle.scenario, colour=False), 0)).frame(1).left
    colour = RenderedFlight(vehicle).frame(1).left
    assert np.abs(cv2.cvtColor(colour, cv2.COLOR_BGR2GRAY).astype(int) - grey).max() <= 2


def test_a_right_camera_with_falloff_works_in_colour(ground: Ground) -> None:
    dim = simulate_vehicle(dataclasses.replace(FARM, colour=True, right_gain=0.5), 0)
    plain = dataclasses.replace(dim, scenario=dataclasses.replace(dim.scenario, right_gain=1.0))
    means = [RenderedFlight(v, ground).frame(0).right.mean() for v in (dim, plain)]
    assert means[0] == pytest.approx(0.5 * means[1], rel=0.02)


def test_samples_of_a_pixel_are_spread_evenly() -> None:
    for count in (1, 4, SAMPLES):
        at = pixel_samples(count)
        for axis in range(2):
            np.testing.assert_allclose(np.sort(at[:, axis]), (np.arange(count) + 0.5) / count - 0.5)
    quarters = [(pixel_samples(16)[:, 0] > 0) == right for right in (False, True)]
    halves = [(pixel_samples(16)[:, 1] > 0) == up for up in (False, True)]
    assert all((a & b).sum() == 4 for a, b in itertools.product(quarters, halves))
