# SPDX-License-Identifier: Apache-2.0
"""The information filter is the Kalman filter in other coordinates: every output of every step, for every model."""

import numpy as np
import pytest
from numpy.typing import NDArray

from uav_vslam.config import ImuConfig
from uav_vslam.errors import FilterDivergence
from uav_vslam.estimation.filter import Filter
from uav_vslam.estimation.information import InformationBelief
from uav_vslam.estimation.models import MODELS, difference
from uav_vslam.estimation.numerics import symmetrise
from uav_vslam.estimation.observation import point_jacobian, triangulation_covariance
from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.rotation import skew, so3_exp
from uav_vslam.ins.propagation import NAV_DIM, POSITION, ROTATION, VELOCITY, propagate, transition
from uav_vslam.types import NavEstimate

Array = NDArray[np.float64]

SIGMA_PX = 1.0
CORRELATION = 1e-6  # P is compared after scaling to unit variances; its condition is about 1e8
MEAN = 1e-8  # [m], [rad] of corrections of a metre

ALL = np.arange(12)


@pytest.fixture(params=sorted(MODELS))
def name(request: pytest.FixtureRequest) -> str:
    return str(request.param)


def assert_same_covariance(P: Array, expected: Array, tolerance: float = CORRELATION) -> None:
    sigma = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(P / np.outer(sigma, sigma), expected / np.outer(sigma, sigma), rtol=0, atol=tolerance)


def dense_jacobian(f: Filter, rows: Array) -> tuple[Array, Array]:
    """Return H (4M, n) and the residual-free prediction (4M,) at the filter's mean."""
    predicted = f.predict_observations(rows)
    m = len(f.covariance()) - 3 * len(f.landmarks)
    H = np.zeros((len(rows), 4, len(f.covariance())))
    H[:, :, :m] = predicted.H_vehicle
    for n, row in enumerate(rows):
        H[n, :, m + 3 * row : m + 3 * row + 3] = predicted.H_landmark[n]
    return H.reshape(-1, len(f.covariance())), predicted.points_left


def shear(before, landmarks_before: Array, after, landmarks_after: Array) -> Array:
    """Return T with dx+ = T dx = dx - [x+ - x]x xi for position, velocity and landmarks."""
    T = np.eye(NAV_DIM + 3 * len(landmarks_after))
    T[POSITION, ROTATION] = -skew(after.T_map_body.t - before.T_map_body.t)
    T[VELOCITY, ROTATION] = -skew(after.v_map - before.v_map)
    T[NAV_DIM:, ROTATION] = -skew(landmarks_after - landmarks_before).reshape(-1, 3)
    return T


def kalman(f: Filter, name: str, rows: Array, pixels: Array) -> tuple:
    """Return nav, landmarks, P and NIS of the textbook Kalman update, dense and inverted."""
    H, points = dense_jacobian(f, rows)
    nu = (pixels - f.rig.project(points)).ravel()
    S = H @ f.covariance() @ H.T + SIGMA_PX**2 * np.eye(len(H))
    K = f.covariance() @ H.T @ np.linalg.inv(S)
    nav, landmarks = MODELS[name]().retract(f.nav, f.landmarks, K @ nu)
    P = (np.eye(len(f.covariance())) - K @ H) @ f.covariance()
    if MODELS[name].invariant:
        T = shear(f.nav, f.landmarks, nav, landmarks)
        P = T @ P @ T.T
    return nav, landmarks, symmetrise(P), float(nu @ np.linalg.inv(S) @ nu)


def test_prediction_is_F_P_Ft_plus_Q(course, name: str) -> None:
    f = course.flown(name)
    increment = course.increments[3]
    F15, Q15 = transition(f.nav, increment, course.imu)
    moved = propagate(f.nav, increment, gravity=course.imu.gravity)
    to_map, from_map = MODELS[name]().to_map(f.nav), MODELS[name]().from_map(moved)
    m = to_map.shape[1]
    F = np.eye(len(f.covariance()))
    F[:m, :m] = from_map @ F15 @ to_map
    expected = F @ f.covariance() @ F.T
    expected[:m, :m] += from_map @ Q15 @ from_map.T
    landmarks = f.landmarks.copy()
    f.predict(increment)
    assert_same_covariance(f.covariance(), expected)
    np.testing.assert_array_equal(f.nav.T_map_body.matrix, moved.T_map_body.matrix)
    np.testing.assert_array_equal(f.landmarks, landmarks)
    assert f.nav.stamp_ns == increment.stamp_ns


def test_update_is_the_kalman_update_in_state_covariance_and_nis(course, name: str) -> None:
    f = course.flown(name)
    rows = np.array([5, 1, 8, 11, 0])
    pixels = course.pixels(3, rows, np.random.default_rng(1))
    nav, landmarks, P, nis = kalman(f, name, rows, pixels)
    moved_before = f.nav
    innovation = f.update(rows, pixels)
    assert np.linalg.norm(f.nav.T_map_body.t - moved_before.T_map_body.t) > 1e-3  # there was something to correct
    np.testing.assert_allclose(f.nav.T_map_body.matrix, nav.T_map_body.matrix, rtol=0, atol=MEAN)
    np.testing.assert_allclose(f.nav.v_map, nav.v_map, rtol=0, atol=MEAN)
    np.testing.assert_allclose(f.nav.gyro_bias, nav.gyro_bias, rtol=0, atol=MEAN)
    np.testing.assert_allclose(f.nav.accel_bias, nav.accel_bias, rtol=0, atol=MEAN)
    np.testing.assert_allclose(f.landmarks, landmarks, rtol=0, atol=MEAN)
    assert_same_covariance(f.covariance(), P)
    assert innovation.nis == pytest.approx(nis, rel=1e-6)
    assert innovation.dof == 20


def test_the_order_of_a_batch_does_not_matter(course, name: str) -> None:
    pixels = course.pixels(3, ALL, np.random.default_rng(1))
    forward, backward = course.flown(name), course.flown(name)
    a, b = forward.update(ALL, pixels), backward.update(ALL[::-1], pixels[::-1])
    Y = forward.belief.Y
    np.testing.assert_allclose(Y, backward.belief.Y, rtol=1e-9, atol=1e-9 * np.abs(Y).max())
    np.testing.assert_allclose(forward.landmarks, backward.landmarks, rtol=0, atol=MEAN)
    assert a.nis == pytest.approx(b.nis, rel=1e-9)


def test_information_of_two_batches_adds_at_one_linearisation(course) -> None:
    """With observations that fit the prediction exactly the mean stays, so two updates equal one."""
    pixels = {}
    for parts in ([ALL], [ALL[:5], ALL[5:]]):
        f = course.flown("ri15")
        fitting = course.rig.project(point_jacobian(course.rig, f.nav, f.landmarks).points_left)
        nis = [f.update(rows, fitting[rows]).nis for rows in parts]
        np.testing.assert_allclose(nis, 0.0, rtol=0, atol=1e-9)
        pixels[len(parts)] = f.belief.Y
    np.testing.assert_allclose(pixels[2], pixels[1], rtol=1e-9, atol=1e-9 * np.abs(pixels[1]).max())


def test_an_update_without_observations_changes_nothing(course, name: str) -> None:
    f = course.flown(name)
    Y, nav, landmarks = f.belief.Y.copy(), f.nav, f.landmarks.copy()
    innovation = f.update(np.zeros(0, np.int64), np.zeros((0, 4)))
    assert (innovation.nis, innovation.dof, innovation.accepted) == (0.0, 0, True)
    np.testing.assert_allclose(f.belief.Y, Y, rtol=1e-13, atol=1e-13 * np.abs(Y).max())
    np.testing.assert_allclose(f.nav.T_map_body.matrix, nav.T_map_body.matrix, rtol=0, atol=1e-14)
    np.testing.assert_allclose(f.landmarks, landmarks, rtol=0, atol=1e-13)


@pytest.mark.parametrize("gone", [[], [0], [3, 7], list(range(12))])
def test_marginalising_drops_rows_of_the_covariance(course, name: str, gone: list[int]) -> None:
    f = course.flown(name)
    m = len(f.covariance()) - 36
    kept = [k for k in range(12) if k not in gone]
    rows = np.concatenate([np.arange(m), *[m + 3 * k + np.arange(3) for k in kept]])
    expected, landmarks = f.covariance()[np.ix_(rows, rows)], f.landmarks[kept]
    f.marginalise(np.array(gone, np.int64))
    assert_same_covariance(f.covariance(), expected)
    np.testing.assert_array_equal(f.landmarks, landmarks)


def test_a_new_landmark_lies_where_it_is_triangulated_and_knows_what_the_pose_knows(course, name: str) -> None:
    f = course.flown(name)
    pixels = course.pixels(3, [2, 6], np.random.default_rng(4))
    P, nav, landmarks = f.covariance(), f.nav, f.landmarks.copy()
    points_left = course.rig.triangulate(pixels)
    T_map_left = nav.T_map_body @ course.rig.T_body_left
    f.add_landmarks(pixels)
    np.testing.assert_array_equal(f.landmarks[:12], landmarks)
    np.testing.assert_allclose(f.landmarks[12:], T_map_left.apply(points_left), rtol=0, atol=1e-12)
    model, m = MODELS[name](), len(P) - 36
    G = np.zeros((6, len(P)))
    for k in range(m):  # how the triangulated points move with the pose
        step = np.zeros(m)
        step[k] = 1e-6
        ends = []
        for sign in (1.0, -1.0):
            moved, _ = model.retract(nav, np.zeros((0, 3)), sign * step)
            ends.append((moved.T_map_body @ course.rig.T_body_left).apply(points_left).ravel())
        G[:, k] = (ends[0] - ends[1]) / 2e-6
    D = np.zeros((6, 6))
    for k, C in enumerate(triangulation_covariance(course.rig, points_left, SIGMA_PX)):
        D[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] = T_map_left.R @ C @ T_map_left.R.T
    assert_same_covariance(f.covariance(), np.block([[P, P @ G.T], [G @ P, G @ P @ G.T + D]]), 1e-5)
    assert f.nav is nav


def test_adding_no_landmark_changes_nothing(course) -> None:
    f = course.flown("ri15")
    Y = f.belief.Y.copy()
    f.add_landmarks(np.zeros((0, 4)))
    np.testing.assert_array_equal(f.belief.Y, Y)
    assert len(f.landmarks) == 12


def test_linearising_at_the_mean_is_a_plain_update(course, name: str) -> None:
    pixels = course.pixels(3, ALL, np.random.default_rng(1))
    plain, told = course.flown(name), course.flown(name)
    a, b = plain.update(ALL, pixels), told.update(ALL, pixels, linearise_at=told.nav.T_map_body)
    np.testing.assert_allclose(told.nav.T_map_body.matrix, plain.nav.T_map_body.matrix, rtol=0, atol=MEAN)
    np.testing.assert_allclose(told.landmarks, plain.landmarks, rtol=0, atol=MEAN)
    assert_same_covariance(told.covariance(), plain.covariance())
    assert b.nis == pytest.approx(a.nis, rel=1e-6)


def test_linearising_near_the_mean_hardly_changes_the_update(course) -> None:
    """The prior stays where it was: another linearisation point 2 cm and 0.3 mrad off moves the result by a tenth."""
    pixels = course.pixels(3, ALL, np.random.default_rng(1))
    plain, told = course.flown("ri15"), course.flown("ri15")
    mean = told.nav.T_map_body
    near = Pose(so3_exp([2e-4, -1e-4, 2e-4]) @ mean.R, mean.t + np.array([0.02, -0.01, 0.01]))
    a, b = plain.update(ALL, pixels), told.update(ALL, pixels, linearise_at=near)
    assert np.linalg.norm(told.nav.T_map_body.t - plain.nav.T_map_body.t) < 2e-3
    assert np.abs(told.landmarks - plain.landmarks).max() < 5e-3
    assert b.nis == pytest.approx(a.nis, rel=0.05)


def test_linearising_at_the_true_pose_helps_a_mean_that_is_far_off(course) -> None:
    """A prior of the right size 3 m and 2 degrees off: one step from there is worse than one from the true pose."""
    truth = course.true_state(3)
    errors = {}
    for linearise_at in (None, truth.T_map_body):
        f = course.flown("ri15")
        nav = f.nav
        shift = np.concatenate([[2.0, -2.0, 1.5], np.zeros(3), [0.02, 0.02, 0.03], np.zeros(42)])
        f.nav = MODELS["so15"]().retract(nav, np.zeros((0, 3)), shift[:15])[0]
        f.belief = InformationBelief(np.linalg.inv(f.covariance() + np.diag(shift**2)), 15)
        f.update(ALL, course.pixels(3, ALL), linearise_at=linearise_at)
        errors[linearise_at is None] = np.linalg.norm(f.nav.T_map_body.t - truth.T_map_body.t)
    assert errors[False] < errors[True]


def test_nav_estimate_is_in_map_frame_errors(course, name: str) -> None:
    f = course.flown(name)
    estimate = f.nav_estimate()
    C, m = MODELS[name]().to_map(f.nav), len(f.covariance()) - 36
    np.testing.assert_allclose(estimate.covariance, C @ f.covariance()[:m, :m] @ C.T, rtol=1e-9, atol=1e-15)
    assert estimate.state is f.nav
    rows = [0, 1, 2, 6, 7, 8]
    np.testing.assert_array_equal(estimate.pose.covariance, estimate.covariance[np.ix_(rows, rows)])


def test_pose_landmark_information_is_the_inverse_of_the_marginal_covariance(course, name: str) -> None:
    f = course.flown(name)
    C, m = MODELS[name]().to_map(f.nav), len(f.covariance()) - 36
    J = np.zeros((6 + 36, len(f.covariance())))
    J[:6, :m] = C[[0, 1, 2, 6, 7, 8]]
    J[6:, m:] = np.eye(36)
    expected = J @ f.covariance() @ J.T
    assert_same_covariance(np.linalg.inv(f.pose_landmark_information()), expected, 1e-5)


def test_initial_information_is_that_of_the_initial_covariance(course, name: str) -> None:
    f = course.filter(name)
    back = f.nav_estimate().covariance
    known = 9 if name == "euler9" else 15
    np.testing.assert_allclose(back[:known, :known], course.initial.covariance[:known, :known], rtol=1e-9, atol=1e-15)


def test_a_start_without_uncertainty_is_refused_with_the_block_named(course) -> None:
    bad = NavEstimate(course.initial.state, np.zeros((15, 15)))
    with pytest.raises(FilterDivergence, match="initial covariance is not positive definite"):
        Filter(bad, rig=course.rig, imu=ImuConfig())


def test_a_divergence_names_the_time_wherever_it_shows(course) -> None:
    f = course.flown("ri15")
    f.belief = InformationBelief(np.full((51, 51), np.nan), 15)
    looks = (f.nav_estimate, f.pose_landmark_information, lambda: f.predict_observations(ALL))
    for step in (*looks, lambda: f.update(ALL, course.pixels(3, ALL)), lambda: f.marginalise(ALL[:3])):
        with pytest.raises(FilterDivergence, match=rf"^at {f.nav.stamp_ns / 1e9:.3f} s: (?!at ).*eigenvalue nan"):
            step()


# The four directions that no camera and no inertial unit can see: shifts of the world, and its yaw about gravity.


def unobservable(f: Filter) -> Array:
    """Return (n, 4) errors of shifts along x, y, z and of a yaw about z, at the current mean; 15-state models."""
    n = len(f.landmarks)
    N = np.zeros((15 + 3 * n, 4))
    up = np.array([0.0, 0.0, 1.0])
    N[POSITION, :3] = np.eye(3)
    N[15:, :3] = np.tile(np.eye(3), (n, 1))
    N[POSITION, 3] = np.cross(up, f.nav.T_map_body.t)
    N[VELOCITY, 3] = np.cross(up, f.nav.v_map)
    N[ROTATION, 3] = up
    N[15:, 3] = np.cross(up, f.landmarks).ravel()
    return N


def information_gained(course, name: str, smoothing: float, seed: int, *, relinearise: bool = False) -> Array:
    """Fly from a prior that knows nothing of the four directions; return what the filter then claims of each."""
    rng = np.random.default_rng(seed)
    f = course.filter(name, depth_sigma_ratio=smoothing)
    N = unobservable(f)
    Q, _ = np.linalg.qr(N)
    ignorant = np.eye(15) - Q @ Q.T
    f.belief = InformationBelief(
        symmetrise(ignorant @ f.belief.Y @ ignorant + 1e-6 * Q @ Q.T), 15
    )  # a kilometre of doubt
    start = np.diag(N.T @ f.belief.Y @ N)
    f.add_landmarks(course.pixels(0, np.arange(8), rng))
    in_state = list(range(8))
    for frame in range(1, 8):
        f.predict(course.increments[frame - 1])
        elsewhere = _near(course.true_state(frame).T_map_body, rng) if relinearise else None
        f.update(np.arange(len(in_state)), course.pixels(frame, in_state, rng), linearise_at=elsewhere)
        if frame == 3:
            f.marginalise(np.array([1, 4]))
            in_state = [k for n, k in enumerate(in_state) if n not in (1, 4)]
        if frame == 4:
            f.add_landmarks(course.pixels(frame, np.arange(8, 12), rng))
            in_state += list(range(8, 12))
    N = unobservable(f)
    return np.asarray(np.diag(N.T @ f.belief.Y @ N) - start)


def _near(pose: Pose, rng: np.random.Generator) -> Pose:
    return Pose(so3_exp(rng.normal(0, 0.02, 3)) @ pose.R, pose.t + rng.normal(0, 1.0, 3))


# Rounding: entries of Y reach 1e6, and yaw sums them over levers of 30 m: 1e-16 * 1e6 and * 30^2, with a margin of 10.
NO_INFORMATION = np.array([1e-9, 1e-9, 1e-9, 1e-6])  # [1/m^2] three times, [1/rad^2]


@pytest.mark.parametrize("smoothing", [0.0, 0.043])
def test_the_invariant_filter_learns_nothing_of_global_position_and_yaw(course, smoothing: float) -> None:
    assert (information_gained(course, "ri15", smoothing, seed=1) < NO_INFORMATION).all()


def test_it_learns_nothing_of_them_either_when_updates_are_linearised_elsewhere(course) -> None:
    gained = information_gained(course, "ri15", 0.0, seed=1, relinearise=True)
    assert (gained < NO_INFORMATION).all()


def test_the_ordinary_filter_believes_to_have_learnt_its_yaw(course) -> None:
    gained = information_gained(course, "so15", 0.0, seed=1)
    assert gained[3] > 100.0  # within a second: a yaw of less than 6 degrees from nothing
    assert (gained[:3] < NO_INFORMATION[:3]).all()  # shifts are linear: even this filter keeps them


def test_difference_gives_the_prior_offset_of_another_linearisation(course) -> None:
    """`difference` is what the relinearised update stands on: retracting by it returns to the mean."""
    f = course.flown("ri15")
    there = course.true_state(3)
    delta = difference(there, f.landmarks, f.nav, f.landmarks)
    nav, landmarks = MODELS["ri15"]().retract(there, f.landmarks, delta)
    np.testing.assert_allclose(nav.T_map_body.matrix, f.nav.T_map_body.matrix, rtol=0, atol=MEAN)
    np.testing.assert_allclose(landmarks, f.landmarks, rtol=0, atol=MEAN)
