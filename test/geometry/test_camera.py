# SPDX-License-Identifier: Apache-2.0
"""Projection, its Jacobian, distortion and undistortion."""

import dataclasses

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from uav_vslam.errors import CalibrationError
from uav_vslam.geometry.camera import MOST_MAGNIFIED, PinholeCamera

STEP_M = 1e-5  # central differences at some metres' depth
DIFFERENCE = 1e-5  # [px/m] rounding of pixels of order 1000 divided by the step
ROUNDING_PX = 1e-9  # pixels of order 1000 in double precision
UNDISTORTED_PX = 1e-4  # left after 20 fixed-point iterations in the corner of a wide lens
CAMERA = PinholeCamera(1280, 960, 1642.0, 1640.0, 642.0, 470.0)
EUROC = PinholeCamera(
    752, 480, 458.654, 457.296, 367.215, 248.375, np.array([-0.28340811, 0.07395907, 0.00019359, 1.76e-05, 0.0])
)

POINTS = st.tuples(st.floats(-20, 20), st.floats(-20, 20), st.floats(2, 200)).map(np.array)


@given(POINTS)
def test_projection_jacobian_is_the_numerical_one(point) -> None:
    steps = STEP_M * np.eye(3)
    numeric = (CAMERA.project(point + steps) - CAMERA.project(point - steps)).T / (2 * STEP_M)
    np.testing.assert_allclose(CAMERA.project_jacobian(point), numeric, atol=DIFFERENCE, rtol=1e-6)


@given(POINTS)
def test_bearing_and_projection_are_inverse(point) -> None:
    np.testing.assert_allclose(CAMERA.bearings(CAMERA.project(point)) * point[2], point, rtol=0, atol=1e-9)


@given(st.floats(0, EUROC.width - 1), st.floats(0, EUROC.height - 1))
def test_undistortion_inverts_distortion_over_the_whole_image(u: float, v: float) -> None:
    np.testing.assert_allclose(EUROC.distort(EUROC.undistort([u, v])), [u, v], rtol=0, atol=UNDISTORTED_PX)


@pytest.mark.parametrize(("f", "k1", "k2"), [(560.0, -0.30, 0.10), (400.0, -0.25, 0.06)])
def test_a_wide_lens_is_undistorted_up_to_its_corners(f: float, k1: float, k2: float) -> None:
    """Where the fixed-point iteration does not converge."""
    camera = PinholeCamera(1280, 960, f, 1.01 * f, 640.0, 480.0, np.array([k1, k2, 1e-3, -5e-4, 0.0]))
    pixels = np.stack(np.meshgrid(np.linspace(0, 1279, 33), np.linspace(0, 959, 25)), axis=-1)
    np.testing.assert_allclose(camera.distort(camera.undistort(pixels)), pixels, rtol=0, atol=1e-3)


def test_pixels_outside_the_lens_range_are_nan() -> None:
    camera = dataclasses.replace(CAMERA, fx=300.0, fy=300.0, distortion=np.array([-0.4, 0.0, 0.0, 0.0, 0.0]))
    assert np.isnan(camera.undistort([0.0, 0.0])).all()
    np.testing.assert_allclose(camera.distort(camera.undistort([600.0, 400.0])), [600.0, 400.0], rtol=0, atol=1e-3)


def test_distortion_equals_opencv() -> None:
    rays = np.random.default_rng(1).uniform([-0.7, -0.5], [0.7, 0.5], (50, 2))
    points = np.column_stack([rays, np.ones(50)])
    expected, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), EUROC.K, EUROC.distortion)
    np.testing.assert_allclose(EUROC.distort(EUROC.project(points)), expected[:, 0], rtol=0, atol=ROUNDING_PX)


def test_zero_distortion_returns_an_equal_copy() -> None:
    pixels = np.array([[3.0, 4.0], [900.0, 800.0]])
    ideal = CAMERA.undistort(pixels)
    np.testing.assert_array_equal(ideal, pixels)
    assert not np.shares_memory(ideal, pixels)


@pytest.mark.parametrize("method", ["project", "bearings", "distort", "undistort", "project_jacobian"])
@pytest.mark.parametrize("camera", [CAMERA, EUROC], ids=["plain", "distorted"])
def test_no_points_give_no_points(camera: PinholeCamera, method: str) -> None:
    width = 3 if method.startswith("project") else 2
    assert len(getattr(camera, method)(np.zeros((0, width)))) == 0


@pytest.mark.parametrize(
    ("values", "text"),
    [
        ((0, 480, 400.0, 400.0, 300.0, 200.0), "image size 0x480"),
        ((640, -1, 400.0, 400.0, 300.0, 200.0), "image size"),
        ((640, 480, 0.0, 400.0, 300.0, 200.0), "focal length"),
        ((640, 480, 400.0, -1.0, 300.0, 200.0), "focal length"),
        ((640, 480, 400.0, float("nan"), 300.0, 200.0), "focal length"),
        ((640, 480, 400.0, float("inf"), 300.0, 200.0), "focal length"),
        ((640, 480, 400.0, 400.0, 300.0, 200.0, np.zeros(4)), "plumb_bob needs 5 values"),
    ],
)
def test_an_invalid_calibration_is_rejected(values, text: str) -> None:
    with pytest.raises(CalibrationError, match=text):
        PinholeCamera(*values)


# Lenses of the other models: a phone's wide angle, and the 190 degree fisheye of TUM-VI's kind.
RATIONAL = PinholeCamera(
    1280,
    960,
    800.0,
    801.0,
    640.0,
    480.0,
    np.array([0.3, 0.1, 1e-3, -5e-4, 0.02, 0.6, 0.2, 0.03]),
    "rational_polynomial",
)
FISHEYE = PinholeCamera(
    512, 512, 190.9, 190.9, 254.9, 256.8, np.array([3.4e-3, 7.1e-4, -2.0e-3, 2.0e-4]), "equidistant"
)


def test_a_rational_lens_is_opencvs() -> None:
    rays = np.random.default_rng(2).uniform([-0.7, -0.5], [0.7, 0.5], (50, 2))
    points = np.column_stack([rays, np.ones(50)])
    expected, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), RATIONAL.K, RATIONAL.distortion)
    np.testing.assert_allclose(RATIONAL.distort(RATIONAL.project(points)), expected[:, 0], rtol=0, atol=ROUNDING_PX)


def test_a_fisheye_is_opencvs() -> None:
    rays = np.random.default_rng(2).uniform(-3.0, 3.0, (50, 2))
    points = np.column_stack([rays, np.ones(50)])
    expected, _ = cv2.fisheye.projectPoints(
        points[:, None], np.zeros(3), np.zeros(3), FISHEYE.K, np.asarray(FISHEYE.distortion)
    )
    np.testing.assert_allclose(FISHEYE.distort(FISHEYE.project(points)), expected[:, 0], rtol=0, atol=1e-6)
    axis = FISHEYE.distort([FISHEYE.cx, FISHEYE.cy])
    np.testing.assert_allclose(axis, [FISHEYE.cx, FISHEYE.cy], rtol=0, atol=ROUNDING_PX)


@pytest.mark.parametrize("camera", [RATIONAL, FISHEYE], ids=["rational_polynomial", "equidistant"])
def test_opencv_inverts_the_lens_wherever_a_pinhole_can_stand_for_it(camera: PinholeCamera) -> None:
    grid = np.stack(np.meshgrid(np.arange(0.0, camera.width, 16), np.arange(0.0, camera.height, 16)), axis=-1)
    ideal = camera.undistort(grid)
    found = np.isfinite(ideal).all(axis=-1)
    np.testing.assert_allclose(camera.distort(ideal[found]), grid[found], rtol=0, atol=1e-3)
    angle = np.linalg.norm((grid - [camera.cx, camera.cy]) / camera.fx, axis=-1)  # about, in both models
    assert found[angle < 1.3].all()
    assert not found[angle > 1.5].any()


@pytest.mark.parametrize("camera", [EUROC, FISHEYE, RATIONAL], ids=["radial", "fisheye", "rational"])
def test_errors_grow_where_the_lens_is_undistorted(camera: PinholeCamera) -> None:
    rng, sigma_px = np.random.default_rng(3), 1e-3
    raw = camera.centre + np.array([[0.0, 0.0], [0.3, 0.1], [-0.4, 0.0], [0.3, -0.45]]) * camera.size
    errors = camera.undistort(raw + rng.normal(0.0, sigma_px, (4000, 4, 2))) - camera.undistort(raw)
    rms = np.sqrt(np.mean(errors**2, axis=(0, 2)))
    np.testing.assert_allclose(camera.magnification(camera.undistort(raw)) * sigma_px, rms, rtol=0.03)


def test_errors_keep_their_size_without_distortion_and_are_bounded_where_nothing_is_imaged() -> None:
    np.testing.assert_array_equal(CAMERA.magnification(np.zeros((3, 2))), np.ones(3))
    folded = dataclasses.replace(CAMERA, distortion=np.array([-0.4, 0.0, 0.0, 0.0, 0.0]))
    np.testing.assert_array_equal(folded.magnification([[5e3, 400.0], [-9e3, 0.0]]), MOST_MAGNIFIED)


def test_a_model_that_nobody_knows_is_refused_with_those_we_do() -> None:
    with pytest.raises(CalibrationError, match="'omni' is not supported; use plumb_bob, rational_polynomial, equidist"):
        dataclasses.replace(FISHEYE, model="omni")
