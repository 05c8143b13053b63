# SPDX-License-Identifier: Apache-2.0
"""Every filter with every state model: each step equals the Kalman filter's with that filter's linearisation."""

import copy
import dataclasses

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import chi2

from uav_vslam.config import EXACT_RIG, BackendConfig, RigConfig
from uav_vslam.errors import FilterDivergence
from uav_vslam.estimation import iterated_update
from uav_vslam.estimation.covariance import CovarianceBelief
from uav_vslam.estimation.filter import Filter
from uav_vslam.estimation.filters import BOUNDED, FILTERS
from uav_vslam.estimation.h_infinity import bounded
from uav_vslam.estimation.linearisation import Cubature, Jacobians
from uav_vslam.estimation.models import MODELS, difference
from uav_vslam.estimation.observation import point_jacobian, triangulation_covariance
from uav_vslam.estimation.weighted_update import HUBER_PROBABILITY
from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.rotation import skew, so3_exp
from uav_vslam.geometry.stereo import STEREO_DOF
from uav_vslam.ins.propagation import NAV_DIM, POSITION, ROTATION, VELOCITY, propagate, transition
from uav_vslam.numerics import symmetrise
from uav_vslam.types import NavEstimate

Array = NDArray[np.float64]

SIGMA_PX = 0.7
CORRELATION = 1e-9  # P is compared after scaling to unit variances
MEAN = 1e-9  # [m], [rad] for corrections of about a metre

ALL = np.arange(12)
SOME = np.array([5, 1, 8, 11, 0])
NAMES = [name for name in FILTERS if not name.startswith("thesis")]  # the thesis's own need not satisfy these laws
LINEAR = {"eif": Jacobians(), "ekf": Jacobians(), "ukf": Cubature(), "uhf": Cubature()}


@pytest.fixture(scope="module", params=NAMES)
def name(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture(scope="module", params=sorted(MODELS))
def model(request: pytest.FixtureRequest) -> str:
    return str(request.param)


def assert_same_covariance(P: Array, expected: Array, tolerance: float = CORRELATION) -> None:
    sigma = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(P / np.outer(sigma, sigma), expected / np.outer(sigma, sigma), rtol=0, atol=tolerance)


def assert_same_mean(f: Filter, nav, landmarks: Array, tolerance: float = MEAN) -> None:
    np.testing.assert_allclose(f.nav.T_map_body.matrix, nav.T_map_body.matrix, rtol=0, atol=tolerance)
    np.testing.assert_allclose(f.nav.v_map, nav.v_map, rtol=0, atol=tolerance)
    np.testing.assert_allclose(f.nav.gyro_bias, nav.gyro_bias, rtol=0, atol=tolerance)
    np.testing.assert_allclose(f.nav.accel_bias, nav.accel_bias, rtol=0, atol=tolerance)
    np.testing.assert_allclose(f.landmarks, landmarks, rtol=0, atol=tolerance)


def content(f: Filter) -> list[Array]:
    """Return copies of a filter's whole state."""
    nav = [f.nav.T_map_body.matrix, f.nav.v_map, f.nav.gyro_bias, f.nav.accel_bias]
    rig = [f.rig_state.attitude, f.rig_state.vibration, np.array(f.rig_state.time_offset_s)]
    return [a.copy() for a in [*nav, *rig, f.landmarks, copy.copy(f.belief).covariance(np.arange(len(f.landmarks)))]]


def assert_unchanged(f: Filter, before: list[Array]) -> None:
    for now, then in zip(content(f), before, strict=True):
        np.testing.assert_array_equal(now, then)


def kalman(f: Filter, model: str, rows: Array, pixels: Array, weights: Array | None = None) -> tuple:
    """Return nav, landmarks, P, and NIS of the textbook Kalman update, dense and inverted."""
    predicted, P, m = f.predict_observations(rows), f.covariance(), f.vehicle
    H, R = np.zeros((len(rows), 4, len(P))), np.zeros((len(rows), 4, len(rows), 4))
    H[:, :, :m] = predicted.H_vehicle
    for n, row in enumerate(rows):
        H[n, :, m + 3 * row : m + 3 * row + 3] = predicted.H_landmark[n]
        R[n, :, n] = predicted.R[n] / (1.0 if weights is None else weights[n])
    H = H.reshape(-1, len(P))
    nu = (pixels - predicted.expected).ravel()
    S = H @ P @ H.T + R.reshape(len(H), len(H))
    K = P @ H.T @ np.linalg.inv(S)
    nav, landmarks = MODELS[model]().retract(f.nav, f.landmarks, K @ nu)
    I_KH = np.eye(len(P)) - K @ H
    P = I_KH @ P @ I_KH.T + K @ R.reshape(len(H), len(H)) @ K.T
    if MODELS[model].invariant:
        T = chart_transport(f.nav, f.landmarks, nav, landmarks)
        P = T @ P @ T.T
    nis = float(nu @ np.linalg.solve(S, nu))
    return nav, landmarks, symmetrise(P), nis


def chart_transport(before, landmarks_before: Array, after, landmarks_after: Array) -> Array:
    """Return T with dx+ = T dx = dx - [x+ - x]x xi for position, velocity and landmarks."""
    T = np.eye(NAV_DIM + 3 * len(landmarks_after))
    T[POSITION, ROTATION] = -skew(after.T_map_body.t - before.T_map_body.t)
    T[VELOCITY, ROTATION] = -skew(after.v_map - before.v_map)
    T[NAV_DIM:, ROTATION] = -skew(landmarks_after - landmarks_before).reshape(-1, 3)
    return T


def test_the_start_state_is_the_given_one(course, name: str, model: str) -> None:
    f = course.filter(model, name)
    back = f.nav_estimate().covariance
    known = 9 if model == "euler9" else 15
    np.testing.assert_allclose(back[:known, :known], course.initial.covariance[:known, :known], rtol=1e-9, atol=1e-15)
    assert f.nav is course.initial.state
    assert f.landmarks.shape == (0, 3)


def test_a_singular_start_covariance_is_rejected_with_its_name(course, name: str) -> None:
    bad = dataclasses.replace(
        course, vehicle=dataclasses.replace(course.vehicle, initial=without_uncertainty(course.initial))
    )
    with pytest.raises(FilterDivergence, match="initial covariance is not positive definite"):
        bad.filter("ri15", name)


def without_uncertainty(initial: NavEstimate) -> NavEstimate:
    return NavEstimate(initial.state, np.zeros((15, 15)))


def test_prediction_is_F_P_Ft_plus_Q(course, name: str, model: str) -> None:
    f, increment = course.flown(model, name), course.increments[3]
    before, m = f.covariance(), f.vehicle
    process = LINEAR[name].process(MODELS[model](), f.nav, f.belief, increment, course.imu)
    F = np.eye(len(before))
    F[:m, :m] = process.F
    expected = F @ before @ F.T
    expected[:m, :m] += process.Q
    if name in BOUNDED:
        belief, feasibility = bounded(CovarianceBelief(expected, m), BackendConfig().gamma)
        expected = belief.covariance(ALL)
    landmarks = f.landmarks.copy()
    f.predict(increment)
    assert_same_covariance(f.covariance(), expected)
    assert_same_mean(f, process.nav, landmarks, 0.0)
    assert f.nav.stamp_ns == increment.stamp_ns
    assert f.feasibility == (pytest.approx(feasibility, rel=1e-6) if name in BOUNDED else np.inf)


@pytest.mark.parametrize("name", ["eif", "ekf"])
def test_prediction_of_the_extended_filters_is_the_strapdown_model(course, name: str, model: str) -> None:
    f, increment = course.flown(model, name), course.increments[3]
    F15, Q15 = transition(f.nav, increment, course.imu)
    moved = propagate(f.nav, increment, gravity=course.imu.gravity)
    to_map, from_map = MODELS[model]().to_map(f.nav), MODELS[model]().from_map(moved)
    F, m = np.eye(len(f.covariance())), f.vehicle
    F[:m, :m] = from_map @ F15 @ to_map
    expected = F @ f.covariance() @ F.T
    expected[:m, :m] += from_map @ Q15 @ from_map.T
    f.predict(increment)
    assert_same_covariance(f.covariance(), expected)
    np.testing.assert_array_equal(f.nav.T_map_body.matrix, moved.T_map_body.matrix)


def test_prediction_adds_the_rigs_random_walk_and_resets_its_vibration(course, name: str, model: str) -> None:
    rig = RigConfig(flexing=True, attitude_walk_deg=0.1, vibration_sigma_deg=0.02, time_offset_sigma_s=0.01)
    f, m = course.flown(model, name, rig_config=rig), MODELS[model].nav_dim
    f.update(ALL, course.pixels(3, ALL))
    before, state, increment = f.covariance(), f.rig_state, course.increments[3]
    assert state.vibration.any()
    f.predict(increment)
    P, walked = f.covariance()[m : m + 7, m : m + 7], np.deg2rad(0.1) ** 2 * increment.dt_s
    vibration, rest = slice(3, 6), [0, 1, 2, 6]
    loose = 1.0 + (1e-4 if name in BOUNDED else 1e-9)  # the bound inflates everything slightly
    grown = np.diag(P)[rest] - np.diag(before)[m : m + 7][rest] - walked * np.array([1, 1, 1, 0])
    np.testing.assert_allclose(grown / np.diag(P)[rest], 0.0, rtol=0, atol=loose - 1.0)
    np.testing.assert_allclose(P[vibration, vibration], np.deg2rad(0.02) ** 2 * np.eye(3), rtol=1e-6, atol=1e-15)
    assert not f.rig_state.vibration.any()
    assert (f.rig_state.attitude is state.attitude, f.rig_state.time_offset_s) == (True, state.time_offset_s)


def test_a_time_offset_moves_the_pixels_by_rotation_and_velocity_at_the_stamp(course, model: str) -> None:
    """The rotation rate is the gyroscope's at the end of the increment, bias-corrected."""
    f = course.flown(model, rig_config=dataclasses.replace(EXACT_RIG, time_offset_sigma_s=0.01))
    rate = np.array([0.3, -0.2, 0.5]) + f.nav.gyro_bias
    turning = dataclasses.replace(course.increments[3], rate_end=rate, rate_slope_end=np.zeros(3))
    f.predict(turning)
    columns, later = f.predict_observations(ALL).H_vehicle[:, :, -1], 1e-6
    nav, before = f.nav, f.predict_observations(ALL).expected
    R, t = nav.T_map_body.R, nav.T_map_body.t
    turned = Pose(R @ so3_exp(np.array([0.3, -0.2, 0.5]) * later), t + nav.v_map * later)
    f.mean = dataclasses.replace(f.mean, nav=dataclasses.replace(nav, T_map_body=turned))
    np.testing.assert_allclose((f.predict_observations(ALL).expected - before) / later, columns, rtol=0, atol=1e-2)


def test_landmarks_are_added_only_after_the_first_increment_if_the_time_offset_is_a_state(course) -> None:
    rig = RigConfig(time_offset_sigma_s=0.01)
    f = course.filter(rig_config=rig)
    assert not f.can_add_landmarks
    f.predict(course.increments[0])
    assert f.can_add_landmarks
    told = course.filter(rig_config=rig)
    told.starts(course.increments[0])
    assert told.can_add_landmarks
    assert course.filter().can_add_landmarks


def test_update_is_the_kalman_update_in_every_output(course, name: str, model: str) -> None:
    f = course.flown(model, name, sigma_px=SIGMA_PX)
    pixels = course.pixels(3, SOME, np.random.default_rng(1))
    nav, landmarks, P, nis = kalman(f, model, SOME, pixels)
    moved_before = f.nav
    innovation = f.update(SOME, pixels)
    assert np.linalg.norm(f.nav.T_map_body.t - moved_before.T_map_body.t) > 1e-3  # the correction is not trivial
    assert_same_mean(f, nav, landmarks)
    assert_same_covariance(f.covariance(), P)
    assert innovation.nis == pytest.approx(nis, rel=1e-6)
    assert (innovation.dof, innovation.accepted, innovation.downweighted) == (20, True, 0)


def test_joint_innovation_has_the_single_ones_on_its_diagonal(course, name: str, model: str) -> None:
    f = course.flown(model, name)
    pixels = course.pixels(3, SOME)
    predicted, (nu, S) = f.predict_observations(SOME), f.joint_innovation(SOME, pixels)
    np.testing.assert_array_equal(nu, pixels - predicted.expected)
    for n in range(len(SOME)):
        np.testing.assert_allclose(
            S[4 * n : 4 * n + 4, 4 * n : 4 * n + 4], predicted.innovation_covariance()[n], rtol=1e-9, atol=1e-9
        )


def test_the_order_of_a_batch_does_not_matter(course, name: str, model: str) -> None:
    pixels = course.pixels(3, ALL, np.random.default_rng(1))
    forward, backward = course.flown(model, name), course.flown(model, name)
    a, b = forward.update(ALL, pixels), backward.update(ALL[::-1], pixels[::-1])
    assert_same_mean(backward, forward.nav, forward.landmarks)
    assert_same_covariance(backward.covariance(), forward.covariance(), 1e-7)
    assert a.nis == pytest.approx(b.nis, rel=1e-8)


@pytest.mark.parametrize("name", ["eif", "ekf"])
def test_information_of_two_batches_adds_at_one_linearisation(course, name: str) -> None:
    """Observations equal to the prediction leave the mean unchanged, so two updates equal one."""
    Y = []
    for parts in ([ALL], [ALL[:5], ALL[5:]]):
        f = course.flown("ri15", name)
        fitting = course.rig.project(point_jacobian(course.rig, f.nav, f.landmarks).points_left)
        nis = [f.update(rows, fitting[rows]).nis for rows in parts]
        np.testing.assert_allclose(nis, 0.0, rtol=0, atol=1e-9)
        Y.append(f.belief.information(np.arange(f.belief.size)))
    scale = np.sqrt(np.outer(np.diag(Y[0]), np.diag(Y[0])))
    np.testing.assert_allclose(Y[1] / scale, Y[0] / scale, rtol=0, atol=1e-8)


def test_a_rejected_update_changes_nothing(course, name: str, model: str) -> None:
    """Also with another linearisation point."""
    f = course.flown(model, name)
    before = content(f)
    wrong = course.pixels(3, ALL) + np.random.default_rng(1).normal(0, 30.0, (12, 4))
    for elsewhere in (None, course.true_state(3).T_map_body):
        innovation = f.update(ALL, wrong, linearise_at=elsewhere, significance=1e-3)
        assert not innovation.accepted
        assert innovation.nis > 1e3
        assert_unchanged(f, before)
    assert f.update(ALL, course.pixels(3, ALL, np.random.default_rng(1)), significance=1e-3).accepted


def test_an_update_without_observations_changes_nothing(course, name: str, model: str) -> None:
    f = course.flown(model, name)
    P, nav, landmarks = f.covariance(), f.nav, f.landmarks.copy()
    innovation = f.update(np.zeros(0, np.int64), np.zeros((0, 4)))
    assert (innovation.nis, innovation.dof) == (0.0, 0)
    assert innovation.accepted
    assert_same_covariance(f.covariance(), P, 1e-8)
    assert_same_mean(f, nav, landmarks, 1e-13)


def test_adding_no_landmark_changes_nothing(course, name: str, model: str) -> None:
    f = course.flown(model, name)
    before = content(f)
    f.add_landmarks(np.zeros((0, 4)))
    assert_unchanged(f, before)


def test_new_points_are_linearised_at_the_depth_of_known_ground(course, name: str, model: str) -> None:
    """Points that no landmark explains are often wrong matches, whose own depths scatter as in a room."""
    f = course.filter(model, name, depth_sigma_ratio=BackendConfig().depth_sigma_ratio)
    f.add_landmarks(course.pixels(0, ALL))
    right = np.sqrt(np.diagonal(f.covariance())[f.vehicle :].reshape(-1, 3)[:, 2])
    pixels = course.pixels(0, ALL)
    pixels[:, 3] += np.linspace(-8.0, 8.0, len(ALL))  # of 18 px of disparity
    f.add_landmarks(pixels)
    wrong = np.sqrt(np.diagonal(f.covariance())[f.vehicle :].reshape(-1, 3)[len(ALL) :, 2])
    depth = f.points_left()[len(ALL) :, 2]
    assert depth.max() > 2.4 * depth.min()
    np.testing.assert_allclose(wrong, right.mean(), rtol=0.3)


def test_no_landmarks_give_empty_predictions_and_additions(course, name: str, model: str) -> None:
    f = course.filter(model, name)
    f.add_landmarks(np.zeros((0, 4)))
    f.predict(course.increments[0])
    assert f.predict_observations(np.zeros(0, np.int64)).innovation_covariance().shape == (0, 4, 4)
    assert f.points_left().shape == (0, 3)
    assert f.landmarks.shape == (0, 3)
    f.marginalise(np.zeros(0, np.int64))
    assert f.pose_landmark_information().shape == (6, 6)
    assert len(f.covariance()) == f.vehicle


def test_steps_do_not_modify_their_arguments(course, name: str, model: str) -> None:
    f = course.flown(model, name)
    rows, pixels = SOME.copy(), course.pixels(3, SOME)
    new, gone = course.pixels(3, [2, 6]), np.array([1, 4])
    increment, at = course.increments[3], course.true_state(3).T_map_body
    arrays = [rows, pixels, new, gone, increment.delta_R, increment.delta_p, increment.covariance, at.R, at.t]
    arrays += [course.initial.covariance, course.initial.state.T_map_body.t]
    before = [a.copy() for a in arrays]
    f.predict_observations(rows)
    f.joint_innovation(rows, pixels)
    f.update(rows, pixels, linearise_at=at)
    f.add_landmarks(new)
    f.marginalise(gone)
    f.predict(increment)
    for now, then in zip(arrays, before, strict=True):
        np.testing.assert_array_equal(now, then)


def test_queries_change_nothing(course, name: str, model: str) -> None:
    f = course.flown(model, name)
    before, pixels = content(f), course.pixels(3, SOME)
    f.predict_observations(SOME)
    f.joint_innovation(SOME, pixels)
    f.points_left()
    f.nav_estimate()
    f.pose_landmark_information()
    f.rig_evidence()
    f.covariance()[:] = np.nan  # callers get a copy
    f.nav_estimate().covariance[:] = np.nan
    assert_unchanged(f, before)


def test_the_same_flight_gives_the_same_bits(course, name: str, model: str) -> None:
    assert_unchanged(course.flown(model, name), content(course.flown(model, name)))


@pytest.mark.parametrize("gone", [[], [0], [7, 3], list(range(12))])
def test_marginalising_drops_rows_of_the_covariance(course, name: str, model: str, gone: list[int]) -> None:
    f = course.flown(model, name)
    kept = [k for k in range(12) if k not in gone]
    rows = np.concatenate([np.arange(f.vehicle), *[f.vehicle + 3 * k + np.arange(3) for k in kept]])
    expected, landmarks = f.covariance()[np.ix_(rows, rows)], f.landmarks[kept]
    f.marginalise(np.array(gone, np.int64))
    assert_same_covariance(f.covariance(), expected)
    np.testing.assert_array_equal(f.landmarks, landmarks)


def test_a_new_landmark_is_triangulated_and_inherits_the_pose_uncertainty(course, name: str, model: str) -> None:
    f = course.flown(model, name, sigma_px=SIGMA_PX)
    pixels = course.pixels(3, [2, 6], np.random.default_rng(4))
    P, nav, landmarks = f.covariance(), f.nav, f.landmarks.copy()
    points_left = course.rig.triangulate(pixels)
    T_map_left = nav.T_map_body @ course.rig.T_body_left
    f.add_landmarks(pixels)
    np.testing.assert_array_equal(f.landmarks[:12], landmarks)
    np.testing.assert_allclose(f.landmarks[12:], T_map_left.apply(points_left), rtol=0, atol=1e-12)
    G = np.zeros((6, len(P)))
    for k in range(f.vehicle):  # derivative of the triangulated points by the pose
        step = np.zeros(f.vehicle)
        step[k] = 1e-6
        ends = []
        for sign in (1.0, -1.0):
            moved, _ = MODELS[model]().retract(nav, np.zeros((0, 3)), sign * step)
            ends.append((moved.T_map_body @ course.rig.T_body_left).apply(points_left).ravel())
        G[:, k] = (ends[0] - ends[1]) / 2e-6
    D = np.zeros((6, 6))
    for k, C in enumerate(triangulation_covariance(course.rig, points_left, SIGMA_PX)):
        D[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] = T_map_left.R @ C @ T_map_left.R.T
    assert_same_covariance(f.covariance(), np.block([[P, P @ G.T], [G @ P, G @ P @ G.T + D]]), 1e-5)
    assert f.nav is nav


@pytest.mark.parametrize("name", ["eif", "ekf"])
def test_linearising_at_the_mean_is_a_plain_update(course, name: str, model: str) -> None:
    pixels = course.pixels(3, ALL, np.random.default_rng(1))
    plain, relinearised = course.flown(model, name), course.flown(model, name)
    a, b = plain.update(ALL, pixels), relinearised.update(ALL, pixels, linearise_at=relinearised.nav.T_map_body)
    assert_same_mean(relinearised, plain.nav, plain.landmarks)
    assert_same_covariance(relinearised.covariance(), plain.covariance())
    assert b.nis == pytest.approx(a.nis, rel=1e-6)


def test_linearising_near_the_mean_hardly_changes_the_update(course, name: str) -> None:
    """The prior is unchanged: a linearisation point 2 cm and 0.3 mrad off changes the correction by a tenth."""
    pixels = course.pixels(3, ALL, np.random.default_rng(1))
    plain, relinearised = course.flown("ri15", name), course.flown("ri15", name)
    mean = relinearised.nav.T_map_body
    near = Pose(so3_exp([2e-4, -1e-4, 2e-4]) @ mean.R, mean.t + np.array([0.02, -0.01, 0.01]))
    a, b = plain.update(ALL, pixels), relinearised.update(ALL, pixels, linearise_at=near)
    assert np.linalg.norm(relinearised.nav.T_map_body.t - plain.nav.T_map_body.t) < 2e-3
    assert np.abs(relinearised.landmarks - plain.landmarks).max() < 5e-3
    assert b.nis == pytest.approx(a.nis, rel=0.05)


def test_linearising_at_the_true_pose_helps_a_mean_that_is_far_off(course, name: str) -> None:
    """A consistent prior 3 m and 2 degrees off: an update linearised there is worse than one at the true pose."""
    truth = course.true_state(3)
    errors = {}
    for linearise_at in (None, truth.T_map_body):
        f = course.flown("ri15", name)
        shift = np.concatenate([[2.0, -2.0, 1.5], np.zeros(3), [0.02, 0.02, 0.03], np.zeros(42)])
        f.mean = dataclasses.replace(f.mean, nav=MODELS["so15"]().retract(f.nav, np.zeros((0, 3)), shift[:15])[0])
        course.set_covariance(f, f.covariance() + np.diag(shift**2))
        f.update(ALL, course.pixels(3, ALL), linearise_at=linearise_at)
        errors[linearise_at is None] = np.linalg.norm(f.nav.T_map_body.t - truth.T_map_body.t)
    assert errors[False] < errors[True]


@pytest.mark.parametrize("name", ["eif", "ekf"])
def test_an_update_that_leads_far_is_linearised_where_it_leads(course, name: str, monkeypatch) -> None:
    """A consistent prior 12 m and 8 degrees off ends where linearising at the true pose does."""
    truth, ends = course.true_state(3).T_map_body, {}
    for case, at, times in (("at the truth", truth, 0), ("once", None, 0), ("again", None, 4)):
        monkeypatch.setattr(iterated_update, "RELINEARISATIONS", times)
        f = course.flown("ri15", name)
        shift = np.concatenate([[8.0, -8.0, 4.0], np.zeros(3), [0.08, 0.08, 0.08], np.zeros(42)])
        f.mean = dataclasses.replace(f.mean, nav=MODELS["so15"]().retract(f.nav, np.zeros((0, 3)), shift[:15])[0])
        course.set_covariance(f, f.covariance() + np.diag(shift**2))
        assert f.update(ALL, course.pixels(3, ALL), linearise_at=at).accepted
        ends[case] = f.nav.T_map_body.t
    off = {case: np.linalg.norm(end - ends["at the truth"]) for case, end in ends.items()}
    assert off["again"] < 0.1 * off["once"]


@pytest.mark.parametrize(
    ("used", "tilt_rad", "shift_m", "accepted"),
    [(7, 0.2, 12.0, False), (12, 0.2, 12.0, True), (7, 0.05, 12.0, True), (7, 0.2, 3.0, True)],
)
def test_few_landmarks_do_not_lead_far_while_the_tilt_is_unknown(
    course, used: int, tilt_rad: float, shift_m: float, accepted: bool
) -> None:
    """At a depth of 70 m a shift of 12 m looks like a tilt of 0.17 rad."""
    f = course.flown("ri15", "eif")
    shift = np.zeros(15)
    shift[0] = shift_m
    f.mean = dataclasses.replace(f.mean, nav=MODELS["so15"]().retract(f.nav, np.zeros((0, 3)), shift)[0])
    before = f.nav
    sigma = np.concatenate([np.full(3, 12.0), np.zeros(3), np.full(3, tilt_rad), np.zeros(f.belief.size - 9)])
    course.set_covariance(f, f.covariance() + np.diag(sigma**2))
    assert f.update(ALL[:used], course.pixels(3, ALL[:used])).accepted == accepted
    assert (f.nav is before) == (not accepted)


@pytest.mark.parametrize("name", ["ukf", "uhf"])
def test_regression_at_another_linearisation_point_uses_the_posterior_belief(course, name: str) -> None:
    """After a long gap the pose uncertainty is 20 m at 70 m height, and 12 landmarks reduce it to centimetres.

    Regression over these 20 m would leave several times the uncertainty of Jacobians at the true pose.
    """
    sigma_m = {}
    for which, linearise_at in (("eif", True), (name, True), (name, False)):
        f = course.flown("ri15", which)
        sigma = np.concatenate([np.full(3, 20.0), np.zeros(f.belief.size - 3)])
        course.set_covariance(f, f.covariance() + np.diag(sigma**2))
        f.update(ALL, course.pixels(3, ALL), linearise_at=course.true_state(3).T_map_body if linearise_at else None)
        sigma_m[which, linearise_at] = np.sqrt(np.trace(f.nav_estimate().covariance[:3, :3]))
    assert sigma_m[name, True] == pytest.approx(sigma_m["eif", True], rel=0.05)
    assert sigma_m[name, False] > 1.5 * sigma_m["eif", True]


def test_difference_gives_the_prior_offset_of_another_linearisation(course) -> None:
    """The relinearised update relies on `difference`: retracting by it returns to the mean."""
    f = course.flown("ri15")
    there = course.true_state(3)
    delta = difference(there, f.landmarks, f.nav, f.landmarks)
    nav, landmarks = MODELS["ri15"]().retract(there, f.landmarks, delta)
    np.testing.assert_allclose(nav.T_map_body.matrix, f.nav.T_map_body.matrix, rtol=0, atol=MEAN)
    np.testing.assert_allclose(landmarks, f.landmarks, rtol=0, atol=MEAN)


def test_nav_estimate_is_in_map_frame_errors(course, name: str, model: str) -> None:
    f = course.flown(model, name)
    estimate = f.nav_estimate()
    C, m = MODELS[model]().to_map(f.nav), f.vehicle
    np.testing.assert_allclose(estimate.covariance, C @ f.covariance()[:m, :m] @ C.T, rtol=1e-6, atol=1e-13)
    assert estimate.state is f.nav
    rows = [0, 1, 2, 6, 7, 8]
    np.testing.assert_array_equal(estimate.pose.covariance, estimate.covariance[np.ix_(rows, rows)])


def test_pose_landmark_information_is_the_inverse_of_the_marginal_covariance(course, name: str, model: str) -> None:
    f = course.flown(model, name)
    C, m = MODELS[model]().to_map(f.nav), f.vehicle
    J = np.zeros((6 + 36, len(f.covariance())))
    J[:6, :m] = C[[0, 1, 2, 6, 7, 8]]
    J[6:, m:] = np.eye(36)
    assert_same_covariance(np.linalg.inv(f.pose_landmark_information()), J @ f.covariance() @ J.T, 1e-5)


def test_a_divergence_is_raised_and_names_the_time(course, name: str, model: str) -> None:
    f = course.flown(model, name)
    f.belief = type(f.belief)(np.full_like(f.covariance(), np.nan), f.vehicle)
    named = rf"^at {f.nav.stamp_ns / 1e9:.3f} s: (?!at ).*smallest eigenvalue nan"
    for query in (f.nav_estimate, f.pose_landmark_information):
        with pytest.raises(FilterDivergence, match=named):
            query()
    if name == "eif":  # the others detect it when the estimate is queried
        steps = (lambda: f.update(ALL, course.pixels(3, ALL)), lambda: f.predict_observations(ALL))
        for step in (*steps, lambda: f.marginalise(SOME)):
            with pytest.raises(FilterDivergence, match=named):
                step()


def test_a_matrix_that_numpy_cannot_factor_is_a_divergence_that_names_the_time(course, monkeypatch) -> None:
    f = course.filter()

    def fail(*_) -> None:
        raise np.linalg.LinAlgError("Singular matrix")

    monkeypatch.setattr(type(f.belief), "predicted", fail)
    with pytest.raises(FilterDivergence, match=r"at [0-9.]+ s: Singular matrix"):
        f.predict(course.increments[0])


def test_nan_pixels_are_rejected(course, name: str, model: str) -> None:
    f = course.flown(model, name)
    before, pixels = content(f), course.pixels(3, SOME)
    pixels[2, 1] = np.nan
    assert not f.update(SOME, pixels).accepted
    assert_unchanged(f, before)


def test_robust_update_is_the_kalman_update_with_huber_weights(course, name: str, model: str) -> None:
    """Weights follow from each landmark's posterior residual after an unweighted update."""
    pixels = course.pixels(3, ALL, np.random.default_rng(1))
    pixels[4] += [25.0, -10.0, 20.0, -10.0]
    f, plain_filter = course.flown(model, name, robust=True), course.flown(model, name)
    predicted, before = plain_filter.predict_observations(ALL), plain_filter.nav
    after, after_landmarks, *_ = kalman(plain_filter, model, ALL, pixels)
    delta = np.append(MODELS[model]().local(before, after), (after_landmarks - plain_filter.landmarks).ravel())
    if MODELS[model].invariant:
        delta = difference(before, plain_filter.landmarks, after, after_landmarks)
    own = delta[plain_filter.vehicle :].reshape(-1, 3)
    left = pixels - predicted.expected - predicted.H_vehicle @ delta[: plain_filter.vehicle]
    left -= np.einsum("nki,ni->nk", predicted.H_landmark, own)
    squares = np.einsum("ni,nij,nj->n", left, np.linalg.inv(predicted.R), left)
    weights = np.minimum(1.0, np.sqrt(chi2.ppf(HUBER_PROBABILITY, STEREO_DOF) / squares))
    assert weights[4] < 0.6
    nav, landmarks, P, nis = kalman(f, model, ALL, pixels, weights)
    innovation = f.update(ALL, pixels)
    assert_same_mean(f, nav, landmarks, 1e-7)
    assert_same_covariance(f.covariance(), P)
    assert innovation.nis == pytest.approx(nis, rel=1e-6)
    assert innovation.downweighted == int((weights < 1).sum()) >= 1


def test_one_outlier_moves_a_robust_filter_far_less(course, name: str, model: str) -> None:
    """Compared with each filter's own result without the outlier."""
    right = course.pixels(3, ALL, np.random.default_rng(1))
    wrong = right.copy()
    wrong[4] += [120.0, -80.0, 120.0, -80.0]
    moved = []
    for robust in (True, False):
        clean, corrupted = (course.flown(model, name, robust=robust) for _ in range(2))
        assert clean.update(ALL, right).downweighted <= 1
        clean_innovation = corrupted.update(ALL, wrong)
        assert clean_innovation.downweighted >= robust
        moved.append(np.linalg.norm(corrupted.nav.T_map_body.t - clean.nav.T_map_body.t))
    assert moved[0] < 0.3 * moved[1]


@pytest.mark.parametrize("model", sorted(MODELS))
def test_the_information_filter_is_the_extended_kalman_filter_over_a_whole_flight(course, model: str) -> None:
    """EIF = EKF in mean, covariance and NIS of each frame, with landmarks added and marginalised."""
    eif, ekf = (course.filter(model, name) for name in ("eif", "ekf"))
    rng = np.random.default_rng(5)
    pixels, in_state = [course.pixels(frame, ALL, rng) for frame in range(8)], ALL[:8]
    for f in (eif, ekf):
        f.add_landmarks(pixels[0][in_state])
    for frame in range(1, 8):
        seen = rng.permutation(len(in_state))[: rng.integers(3, len(in_state) + 1)]
        innovations = []
        for f in (eif, ekf):
            f.predict(course.increments[frame - 1])
            innovations.append(f.update(seen, pixels[frame][in_state[seen]]))
            if frame == 3:
                f.marginalise(np.array([1, 4]))
            if frame == 4:
                f.add_landmarks(pixels[frame][8:])
        if frame == 3:
            in_state = np.delete(in_state, [1, 4])
        if frame == 4:
            in_state = np.append(in_state, ALL[8:])
        P = ekf.covariance()
        assert_same_covariance(eif.covariance(), P)
        off = np.append(MODELS[model]().local(ekf.nav, eif.nav), (eif.landmarks - ekf.landmarks).ravel())
        np.testing.assert_allclose(off / np.sqrt(np.diag(P)), 0.0, rtol=0, atol=1e-9)
        a, b = innovations
        assert a.nis == pytest.approx(b.nis, rel=1e-9)
