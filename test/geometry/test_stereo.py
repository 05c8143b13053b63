# SPDX-License-Identifier: Apache-2.0
"""The stereo rig with any relative pose: baseline along x, along the image's vertical, and converging cameras."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from uav_vslam.errors import CalibrationError
from uav_vslam.geometry.camera import PinholeCamera
from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.rotation import so3_exp
from uav_vslam.geometry.stereo import MIN_BASELINE_M, StereoRig
from uav_vslam.simulation.rig import kagaru_rig

STEP_M = 1e-5  # central differences at metres' depth
DIFFERENCE = 1e-4  # [px/m] pixels of order 1000, rounded to 1e-13 of that, over the step; near points bend more
EPIPOLAR_PX = 1e-8  # a pixel coordinate's rounding after a few products
REMAINING_SIGMA = 0.05  # distance from the optimum after two steps, in standard deviations of the point
T_BODY_LEFT = Pose(so3_exp([0.4, -1.2, 0.9]), np.array([0.05, -0.02, 0.01]))
CONVERGING = StereoRig(
    PinholeCamera(752, 480, 458.0, 457.0, 367.0, 248.0),
    PinholeCamera(752, 480, 455.0, 456.0, 379.0, 255.0),
    T_BODY_LEFT,
    T_BODY_LEFT @ Pose(so3_exp([0.03, -0.08, 0.05]), np.array([0.11, 0.01, -0.005])),
)
RIGS = {"kagaru": kagaru_rig(), "kagaru_half": kagaru_rig(0.5), "converging": CONVERGING}


def scattered_points(rig: StereoRig, count: int = 200, *, far_m: float) -> np.ndarray:
    """Return at most `count` points of the left camera frame, from 2 m to `far_m`, that both cameras see."""
    rng = np.random.default_rng(3)
    size = np.array([rig.left.width, rig.left.height])
    points = rig.left.bearings(rng.uniform(0, size, (count, 2))) * rng.uniform(2.0, far_m, count)[:, None]
    right = rig.project(points)[:, 2:]
    return points[((right >= 0) & (right <= size)).all(axis=1)]


@pytest.fixture(params=sorted(RIGS))
def rig(request: pytest.FixtureRequest) -> StereoRig:
    return RIGS[request.param]


@given(name=st.sampled_from(sorted(RIGS)), u=st.floats(0, 600), v=st.floats(0, 400), depth=st.floats(1.0, 150.0))
def test_projection_jacobian_is_the_numerical_one(name: str, u: float, v: float, depth: float) -> None:
    rig = RIGS[name]
    point = rig.left.bearings([u, v]) * depth
    steps = STEP_M * np.eye(3)
    numeric = (rig.project(point + steps) - rig.project(point - steps)).T / (2 * STEP_M)
    np.testing.assert_allclose(rig.project_jacobian(point), numeric, atol=DIFFERENCE, rtol=1e-6)


def test_triangulation_inverts_projection(rig: StereoRig) -> None:
    points = scattered_points(rig, far_m=150.0)
    # One step of the pixels' last digit is about 1e-12 px; over depth^2 / (f b), at most 500 m/px, that is 1e-9 m.
    np.testing.assert_allclose(rig.triangulate(rig.project(points)), points, rtol=0, atol=1e-8)


def test_triangulation_is_the_least_squares_point(rig: StereoRig) -> None:
    """With noisy pixels the residual is normal to the Jacobian's columns, and no neighbouring point fits better."""
    points = scattered_points(rig, 80, far_m=8.0)  # some pixels of disparity for the short baseline, too
    pixels = rig.project(points) + np.random.default_rng(4).normal(0, 1.0, (len(points), 4))
    found = rig.triangulate(pixels)
    assert np.isfinite(found).all()
    residual = pixels - rig.project(found)
    gradient = np.einsum("nki,nk->ni", rig.project_jacobian(found), residual)
    step = np.linalg.solve(np.einsum("nki,nkj->nij", *[rig.project_jacobian(found)] * 2), gradient[..., None])[..., 0]
    # The error left after two Gauss-Newton steps is far below one pixel of noise.
    assert np.sqrt(np.einsum("ni,ni->n", step, gradient)).max() < REMAINING_SIGMA


def test_the_kagaru_rigs_disparity_runs_along_v() -> None:
    disparity = np.diff(RIGS["kagaru"].project([[0.0, 0.0, 40.0], [0.0, 0.0, 80.0]]), axis=0)[0]
    assert abs(disparity[3]) > 10 * abs(disparity[2])
    assert RIGS["kagaru"].baseline_m == pytest.approx(0.776, abs=1e-3)


def test_parallel_rays_and_points_behind_triangulate_to_nan() -> None:
    rig = RIGS["converging"]
    far = rig.project(rig.left.bearings([[300.0, 200.0]]) * 1e12)
    behind = rig.project(-rig.left.bearings([[300.0, 200.0]]) * 5.0)  # the rays meet behind both cameras
    good = rig.project(rig.left.bearings([[300.0, 200.0]]) * 5.0)
    found = rig.triangulate(np.vstack([far, good, behind]))
    assert np.isnan(found[[0, 2]]).all()
    np.testing.assert_allclose(found[1], rig.left.bearings([300.0, 200.0]) * 5.0, rtol=0, atol=1e-9)


@pytest.mark.parametrize("refinements", [0, 2])
def test_rays_that_meet_behind_the_right_camera_alone_triangulate_to_nan(refinements: int) -> None:
    backward = Pose(so3_exp([0.0, 3.0, 0.0]), np.array([0.5, 0.0, 0.0]))
    rig = dataclasses.replace(CONVERGING, T_body_right=T_BODY_LEFT @ backward)
    point = np.array([[0.1, 0.2, 5.0]])
    assert rig.T_right_left.apply(point)[0, 2] < 0
    assert np.isnan(rig.triangulate(rig.project(point), refinements=refinements)).all()


def test_no_pixels_give_no_points(rig: StereoRig) -> None:
    assert rig.triangulate(np.zeros((0, 4))).shape == (0, 3)
    assert rig.epipolar_distance(np.zeros((0, 4))).shape == (0,)
    assert rig.project(np.zeros((0, 3))).shape == (0, 4)
    assert rig.project_jacobian(np.zeros((0, 3))).shape == (0, 4, 3)


def test_true_pairs_lie_on_their_epipolar_lines(rig: StereoRig) -> None:
    pixels = rig.project(scattered_points(rig, far_m=150.0))
    homogeneous = [np.column_stack([side, np.ones(len(side))]) for side in (pixels[:, :2], pixels[:, 2:])]
    incidence = np.einsum("ni,ij,nj->n", homogeneous[1], rig.fundamental, homogeneous[0])
    assert np.abs(incidence).max() < 1e-8  # F has norm one and its largest entries meet pixels of order one
    assert rig.epipolar_distance(pixels).max() < EPIPOLAR_PX


def test_epipolar_distance_is_in_pixels() -> None:
    rig = RIGS["kagaru"]
    points = scattered_points(rig, 40, far_m=150.0)
    lower, upper = rig.project(points), rig.project(points * 1.001)
    along = upper[:, 2:] - lower[:, 2:]
    across = np.column_stack([-along[:, 1], along[:, 0]]) / np.linalg.norm(along, axis=1, keepdims=True)
    moved = lower.copy()
    moved[:, 2:] += 3.0 * across
    np.testing.assert_allclose(rig.epipolar_distance(moved), 3.0, rtol=1e-3)


@pytest.fixture(params=["pinhole", "fisheye"])
def lens(request: pytest.FixtureRequest) -> StereoRig:
    """Return a rig with 55 degrees to either side, with or without a fisheye's distortion."""
    model = {} if request.param == "pinhole" else {"distortion": np.zeros(4), "model": "equidistant"}
    rig = RIGS["kagaru"]
    left, right = (dataclasses.replace(camera, fx=450.0, fy=450.0, **model) for camera in (rig.left, rig.right))
    return dataclasses.replace(rig, left=left, right=right)


def test_epipolar_distances_due_to_noise_are_as_large_all_over_the_image(lens: StereoRig) -> None:
    points = scattered_points(lens, 20000, far_m=150.0)
    z = lens.project(points)
    raw = np.hstack([lens.left.distort(z[:, :2]), lens.right.distort(z[:, 2:])])
    raw += np.random.default_rng(1).normal(0.0, 0.2, raw.shape)
    noisy = np.hstack([lens.left.undistort(raw[:, :2]), lens.right.undistort(raw[:, 2:])])
    distances = lens.epipolar_distance(noisy)
    far_out = np.linalg.norm(z[:, :2] - lens.left.centre, axis=1) > 1.2 * lens.left.fx  # 50 degrees
    assert far_out.sum() > 300
    both_px = 0.2 * np.sqrt(2.0)
    assert np.median(distances[far_out]) == pytest.approx(np.median(distances[~far_out]), rel=0.25)
    assert np.sqrt(np.mean(distances**2)) == pytest.approx(both_px, rel=0.1)


def test_right_left_transform_follows_from_the_extrinsics(rig: StereoRig) -> None:
    point = np.array([0.3, -0.2, 4.0])
    body = rig.T_body_left.apply(point)
    np.testing.assert_allclose(rig.T_body_right.apply(rig.T_right_left.apply(point)), body, rtol=0, atol=1e-12)


def test_cameras_of_different_size_are_rejected() -> None:
    rig = RIGS["kagaru"]
    with pytest.raises(CalibrationError, match="1280x960 px but right ones 640x480"):
        dataclasses.replace(rig, right=RIGS["kagaru_half"].right)


@pytest.mark.parametrize("forward_m", [-0.5, 0.5])
def test_a_rig_whose_baseline_is_along_the_optical_axis_is_rejected(forward_m: float) -> None:
    rig = kagaru_rig()
    ahead = rig.T_body_left @ Pose(np.eye(3), np.array([0.0, 0.0, forward_m]))
    with pytest.raises(CalibrationError, match=r"0\.5 m apart along their optical axis"):
        dataclasses.replace(rig, T_body_right=ahead)


@pytest.mark.parametrize("baseline_m", [0.0, 0.5 * MIN_BASELINE_M])
def test_a_rig_without_baseline_is_rejected(baseline_m: float) -> None:
    rig = RIGS["converging"]
    T_body_right = Pose(rig.T_body_right.R, rig.T_body_left.t + np.array([baseline_m, 0.0, 0.0]))
    with pytest.raises(CalibrationError, match="baseline"):
        dataclasses.replace(rig, T_body_right=T_body_right)
