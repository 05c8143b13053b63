# SPDX-License-Identifier: Apache-2.0
"""Jacobians against numerical ones, rig errors included; cubature against exact moments and Monte Carlo."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from uav_vslam.config import EXACT_RIG, RigConfig
from uav_vslam.estimation.belief import Marginals, Observation
from uav_vslam.estimation.covariance import CovarianceBelief
from uav_vslam.estimation.linearisation import (
    Camera,
    Cubature,
    Jacobians,
    camera_points,
    cubature_offsets,
    pixel_jacobians,
    regress,
)
from uav_vslam.estimation.models import MODELS, POSE
from uav_vslam.estimation.observation import point_jacobian
from uav_vslam.estimation.rig_errors import RigErrors, RigState
from uav_vslam.estimation.square_root import SquareRootBelief
from uav_vslam.estimation.turning import Turning
from uav_vslam.ins.propagation import propagate, transition

Array = NDArray[np.float64]

STEP = 1e-6  # of each coordinate, central differences
DIFFERENCE = 2e-5  # relative to the largest entry: rounding of pixels of order 1000 over the step is 1e-7 px
SCALED = 1e-9
NONE = np.zeros(0, np.int64)

TURNING = Turning(np.array([0.05, -0.2, 0.1]), np.array([3.0, 1.0, -2.0]))
FLEXING = RigConfig(flexing=True, disparity_sigma_px=0.2, time_offset_sigma_s=0.01)
CALIBRATED = RigState()
BENT = RigState(
    np.array([3e-4, -5e-4, 2e-4]), np.array([1e-4, 2e-4, -3e-4]), disparity_px=0.3, focal_ratio=6e-4, time_offset_s=0.01
)


@pytest.fixture(scope="module", params=sorted(MODELS))
def model(request: pytest.FixtureRequest):
    return MODELS[request.param]()


def camera_at(course, model, config: RigConfig, state: RigState, frame: int = 3) -> Camera:
    """Return the camera of a frame as `Filter` makes it."""
    errors = RigErrors(course.rig, config, model.nav_dim)
    nav = errors.at_exposure(state, course.true_state(frame), TURNING)
    return Camera(errors.rig(state), errors, model, nav, TURNING.rate(state.time_offset_s), 1.0, 0.0)


def pixels_under(course, camera: Camera, state: RigState, frame: int, vehicle: Array, landmarks: Array) -> Array:
    """Return the pixels (M, 4) under the vehicle error `vehicle`, by retracting the means."""
    errors, n = camera.errors, camera.model.nav_dim
    nav, _ = camera.model.retract(course.true_state(frame), np.zeros((0, 3)), vehicle[:n])
    rig = errors.retract(state, vehicle)
    seen_from = errors.at_exposure(rig, nav, TURNING)
    moved = errors.rig(rig)
    return moved.project(point_jacobian(moved, seen_from, landmarks).points_left)


def numerical(course, camera: Camera, state: RigState, frame: int, landmarks: Array) -> tuple[Array, Array]:
    """Return d(pixels)/d(vehicle error) (M, 4, vehicle) and d(pixels)/d(landmark) (M, 4, 3)."""
    size = camera.model.nav_dim + camera.errors.dim
    still = np.zeros(size)
    H_vehicle, H_landmark = np.zeros((len(landmarks), 4, size)), np.zeros((len(landmarks), 4, 3))
    for k in range(size):
        step = np.eye(size)[k] * STEP
        ends = [pixels_under(course, camera, state, frame, s * step, landmarks) for s in (1, -1)]
        H_vehicle[:, :, k] = (ends[0] - ends[1]) / (2 * STEP)
    for k in range(3):
        step = np.eye(3)[k] * STEP
        ends = [pixels_under(course, camera, state, frame, still, landmarks + s * step) for s in (1, -1)]
        H_landmark[:, :, k] = (ends[0] - ends[1]) / (2 * STEP)
    return H_vehicle, H_landmark


def assert_close(found: Array, expected: Array, tolerance: float) -> None:
    np.testing.assert_allclose(found, expected, rtol=0, atol=tolerance * np.abs(expected).max())


@pytest.mark.parametrize(
    "config", [EXACT_RIG, FLEXING, RigConfig(rigid_sigma_deg=0.01)], ids=["rigid", "flexing", "precise"]
)
def test_pixel_jacobians_are_the_numerical_ones_at_the_calibration(course, model, config: RigConfig) -> None:
    camera, landmarks = camera_at(course, model, config, CALIBRATED), course.landmarks[[4, 0, 7]]
    points, J_vehicle, J_landmark = camera_points(camera, landmarks)
    H = pixel_jacobians(camera, points, points, J_vehicle, J_landmark)
    for found, expected in zip(H, numerical(course, camera, CALIBRATED, 3, landmarks), strict=True):
        assert_close(found, expected, DIFFERENCE)


def test_pixel_jacobians_hold_away_from_the_calibration_to_first_order(course, model) -> None:
    """Neglected: J_r of 0.05 degrees of misalignment and 0.1 degree of rotation, and 10 ms of velocity error."""
    camera, landmarks = camera_at(course, model, FLEXING, BENT), course.landmarks[[4, 0, 7]]
    points, J_vehicle, J_landmark = camera_points(camera, landmarks)
    H_vehicle, H_landmark = pixel_jacobians(camera, points, points, J_vehicle, J_landmark)
    expected_vehicle, expected_landmark = numerical(course, camera, BENT, 3, landmarks)
    assert_close(H_landmark, expected_landmark, DIFFERENCE)
    errors = camera.errors
    for columns in (
        slice(0, 3),
        slice(6, 9),
        errors.attitude,
        errors.vibration,
        errors.focal_ratio,
        errors.time_offset,
    ):
        assert_close(H_vehicle[:, :, columns], expected_vehicle[:, :, columns], 5e-3)
    assert not H_vehicle[:, :, 3:6].any()
    assert np.abs(expected_vehicle[:, :, 3:6]).max() < 0.0101 * np.abs(expected_vehicle[:, :, :3]).max()


def test_no_landmarks_give_an_empty_prediction(course, model) -> None:
    camera = camera_at(course, model, FLEXING, BENT)
    vehicle = model.nav_dim + camera.errors.dim
    for linear in (Jacobians(), Cubature()):
        predicted = linear.observation(camera, NONE, np.zeros((0, 3)), blocks(np.eye(vehicle), 0))
        assert predicted.expected.shape == (0, 4)
        assert predicted.H_vehicle.shape == (0, 4, vehicle)
        assert predicted.innovation_covariance().shape == (0, 4, 4)


@given(st.integers(0, 2**32 - 1), st.integers(1, 9), st.integers(1, 6))
def test_regression_returns_a_linear_function_itself(seed: int, d: int, k: int) -> None:
    """In batches of 4: no shift, the exact slope, no linearisation error."""
    rng = np.random.default_rng(seed)
    L = np.array([np.linalg.cholesky(spd(rng, d)) for _ in range(4)])
    A, b = rng.normal(size=(4, k, d)), rng.normal(size=(4, k))
    values = cubature_offsets(L) @ np.swapaxes(A, -1, -2) + b[:, None, :]
    shift, slope, extra = regress(values, b, L)
    np.testing.assert_allclose(shift, 0.0, rtol=0, atol=1e-12)
    np.testing.assert_allclose(slope, A, rtol=0, atol=SCALED)
    np.testing.assert_allclose(extra, 0.0, rtol=0, atol=1e-20)


def spd(rng: np.random.Generator, n: int) -> Array:
    root = np.linalg.qr(rng.normal(size=(n, n)))[0] * rng.uniform(0.5, 2.0, n)
    return root @ root.T


@given(st.integers(0, 2**32 - 1), st.integers(1, 6))
def test_regression_of_a_quadratic_has_its_mean_and_slope(seed: int, d: int) -> None:
    """For f = b x + x^T A x and x ~ N(0, P): mean tr(A P), slope b, and a linearisation error of positive variance."""
    rng = np.random.default_rng(seed)
    P, b, A = spd(rng, d), rng.normal(size=d), rng.normal(size=(d, d))
    L = np.linalg.cholesky(P)
    x = cubature_offsets(L)
    shift, slope, extra = regress((x @ b + np.einsum("ni,ij,nj->n", x, A, x))[:, None], np.zeros(1), L)
    assert shift[0] == pytest.approx(np.trace(A @ P), rel=SCALED, abs=SCALED)
    np.testing.assert_allclose(slope[0], b, rtol=0, atol=SCALED)
    bends = d * np.diag(L.T @ A @ L)
    assert extra[0, 0] == pytest.approx(np.var(bends), rel=SCALED, abs=SCALED)


def test_cubature_offsets_have_the_moments_of_the_gaussian() -> None:
    rng = np.random.default_rng(1)
    P = spd(rng, 5)
    x = cubature_offsets(np.linalg.cholesky(P))
    assert x.shape == (10, 5)
    np.testing.assert_allclose(x.mean(axis=0), 0.0, rtol=0, atol=1e-15)
    np.testing.assert_allclose(x.T @ x / len(x), P, rtol=0, atol=1e-12)


@settings(max_examples=50)
@given(st.integers(0, 2**32 - 1), st.integers(3, 8), st.integers(1, 4))
def test_an_unscented_filter_of_a_linear_system_is_the_kalman_filter(seed: int, m: int, n: int) -> None:
    """Regressed process and observations, square-root form: three steps, all outputs compared."""
    rng = np.random.default_rng(seed)
    P = spd(rng, m)
    belief = SquareRootBelief.from_covariance(P)
    fresh = rng.normal(size=(n, 3, m)), np.array([spd(rng, 3) for _ in range(n)])
    belief, textbook = belief.appended(*fresh), CovarianceBelief.from_covariance(P).appended(*fresh).P
    mean, expected_mean = np.zeros(len(textbook)), np.zeros(len(textbook))
    for _ in range(3):
        F, Q = np.eye(m) + 0.1 * rng.normal(size=(m, m)), spd(rng, m)
        L = np.linalg.cholesky(belief.covariance(NONE))
        shift, A, extra = regress((mean[:m] + cubature_offsets(L)) @ F.T, F @ mean[:m], L)
        mean[:m], belief = F @ mean[:m] + shift, belief.predicted(A, Q + extra)
        whole = np.eye(len(textbook))
        whole[:m, :m] = F
        textbook, expected_mean = whole @ textbook @ whole.T, whole @ expected_mean
        textbook[:m, :m] += Q

        H, z = rng.normal(size=(n, 4, m + 3)), rng.normal(0, 3, (n, 4))
        seen, dense = regressed(belief, mean, H, z)
        update = belief.updated(seen)
        S = dense @ textbook @ dense.T + np.eye(4 * n)
        nu = z.ravel() - dense @ expected_mean
        K = textbook @ dense.T @ np.linalg.inv(S)
        sigma = np.sqrt(np.diag(textbook))
        expected_mean = expected_mean + K @ nu
        I_KH = np.eye(len(K)) - K @ dense
        textbook = I_KH @ textbook @ I_KH.T + K @ K.T
        mean, belief = mean + update.delta, update.belief
        np.testing.assert_allclose((mean - expected_mean) / sigma, 0.0, rtol=0, atol=SCALED)
        error = belief.covariance(np.arange(n)) - textbook
        np.testing.assert_allclose(error / np.outer(sigma, sigma), 0.0, rtol=0, atol=SCALED)
        assert update.nis == pytest.approx(float(nu @ np.linalg.solve(S, nu)), rel=SCALED)


def regressed(belief: SquareRootBelief, mean: Array, H: Array, z: Array) -> tuple[Observation, Array]:
    """Return observations z = H (vehicle, landmark) + noise, H (n, 4, m + 3), by regression, and the dense Jacobian."""
    n, m = len(H), belief.vehicle
    found, nu, dense = [], [], np.zeros((n, 4, belief.size))
    for k in range(n):
        rows = np.concatenate([np.arange(m), m + 3 * k + np.arange(3)])
        L = np.linalg.cholesky(belief.covariance(np.array([k])))
        at = mean[rows]
        shift, A, _ = regress((at + cubature_offsets(L)) @ H[k].T, H[k] @ at, L)
        found.append(A)
        nu.append(z[k] - H[k] @ at - shift)
        dense[k][:, rows] = H[k]
    A = np.array(found)
    return Observation(np.arange(n), A[:, :, :m], A[:, :, m:], np.array(nu)), dense.reshape(-1, belief.size)


def uncertain(course, model, config: RigConfig, scale: float, count: int) -> Array:
    """Return P (vehicle + 3 count, ...) for a pose known to 0.5 m and 1 degree and landmarks to 2 m, times a scale."""
    rng = np.random.default_rng(3)
    vehicle = RigErrors(course.rig, config, model.nav_dim)
    sigma = np.concatenate(
        [
            np.repeat([0.5, 0.2, 0.02], 3),
            np.full(model.nav_dim - 9, 1e-3),
            np.sqrt(np.diag(vehicle.prior_covariance)),
            np.full(3 * count, 2.0),
        ]
    )
    A = rng.normal(size=(len(sigma), len(sigma)))
    C = A @ A.T + len(sigma) * np.eye(len(sigma))
    d = np.sqrt(np.diag(C))
    return scale**2 * C / np.outer(d, d) * np.outer(sigma, sigma)


def inflated(P: Array, row: int, factor: float) -> Array:
    scale = np.ones(len(P))
    scale[row] = factor
    return P * np.outer(scale, scale)


def blocks(P: Array, count: int) -> Marginals:
    """Return the marginals from the full covariance of a vehicle and some landmarks."""
    return CovarianceBelief(P, len(P) - 3 * count).marginals(np.arange(count))


@pytest.mark.parametrize("smoothing", [0.0, 0.043])
def test_cubature_becomes_the_jacobian_as_uncertainty_vanishes(course, model, smoothing: float) -> None:
    """The difference is of second order: a thousandth of the uncertainty leaves a millionth of it."""
    camera = dataclasses.replace(camera_at(course, model, FLEXING, BENT), depth_sigma_ratio=smoothing)
    rows = np.array([4, 0, 7])
    P = uncertain(course, model, FLEXING, 1e-3, 3)
    first = Jacobians().observation(camera, rows, course.landmarks[rows], blocks(P, 3))
    second = Cubature().observation(camera, rows, course.landmarks[rows], blocks(P, 3))
    assert_close(second.H_vehicle, first.H_vehicle, 1e-6)
    assert_close(second.H_landmark, first.H_landmark, 1e-6)
    np.testing.assert_allclose(second.expected, first.expected, rtol=0, atol=1e-4)
    np.testing.assert_allclose(second.R, first.R, rtol=0, atol=1e-6)
    assert_close(second.innovation_covariance(), first.innovation_covariance(), 1e-6)


def test_cubature_predicts_monte_carlo_better_than_the_jacobian(course, model) -> None:
    """Mean and covariance of the pixels over 40 000 antithetic draws of pose and landmark."""
    camera, at = camera_at(course, model, EXACT_RIG, CALIBRATED), course.landmarks[[4]]
    P = inflated(uncertain(course, model, EXACT_RIG, 1.0, 1), -1, 5.0)  # 10 m of height uncertainty, seen from 70 m
    half = np.random.default_rng(0).multivariate_normal(np.zeros(len(P)), P, 20_000, method="cholesky")
    draws = np.vstack([half, -half])
    arm = np.broadcast_to(at - camera.nav.T_map_body.t, (len(draws), 3))
    body = model.perturbed_arms(camera.nav, arm, draws[:, POSE], draws[:, -3:])
    z = camera.rig.project((body - camera.rig.T_body_left.t) @ camera.rig.T_body_left.R)
    mean, S = z.mean(axis=0), np.cov(z.T) + np.eye(4)
    first, second = (
        linear.observation(camera, np.array([4]), at, blocks(P, 1)) for linear in (Jacobians(), Cubature())
    )
    assert np.abs(first.expected[0] - mean).max() > 1.0  # [px]: the projection is nonlinear over the height uncertainty
    assert np.abs(second.expected[0] - mean).max() < 0.2
    missing = [np.linalg.norm(predicted.innovation_covariance()[0] - S) for predicted in (first, second)]
    assert missing[1] < missing[0]  # a third-degree rule captures only part of the fourth moments
    assert missing[1] < 0.04 * np.linalg.norm(S)


@pytest.mark.parametrize("smoothing", [0.0, 0.043])
def test_cubature_observation_is_the_mean_and_covariance_over_its_points(course, model, smoothing: float) -> None:
    """Explicitly: each point retracted, projected and averaged; with smoothing all points are moved to the depth."""
    camera = dataclasses.replace(camera_at(course, model, EXACT_RIG, CALIBRATED), depth_sigma_ratio=smoothing)
    rows, m = np.array([4, 0, 7]), model.nav_dim
    P, landmarks = uncertain(course, model, EXACT_RIG, 1.0, 3), course.landmarks[rows]
    predicted = Cubature().observation(camera, rows, landmarks, blocks(P, 3))
    points, J_vehicle, J_landmark = camera_points(camera, landmarks)
    for n in range(3):
        own = m + 3 * n + np.arange(3)
        J = np.hstack([J_vehicle[n], J_landmark])
        vehicle_and_own = np.append(np.arange(m), own)
        variance = (J @ P[np.ix_(vehicle_and_own, vehicle_and_own)] @ J.T)[2, 2]
        ground = np.median(points[:, 2])
        s = 1.0 if smoothing == 0 else 1.0 / (1.0 + variance / (smoothing * ground) ** 2)
        at = points[n] * (s + (1 - s) * ground / points[n, 2])
        argument = np.append(POSE, own)
        seen = []
        for offset in cubature_offsets(np.linalg.cholesky(P[np.ix_(argument, argument)])):
            delta = np.zeros(m + 3)
            delta[POSE], delta[m:] = offset[:6], offset[6:]
            nav, moved = model.retract(camera.nav, landmarks[[n]], delta)
            seen.append(camera.rig.project(point_jacobian(camera.rig, nav, moved).points_left + at - points[n])[0])
        expected = camera.rig.project(points[n]) + np.mean(seen, axis=0) - camera.rig.project(at)
        np.testing.assert_allclose(predicted.expected[n], expected, rtol=0, atol=1e-8)
        S = np.cov(np.transpose(seen), bias=True) + np.eye(4)
        assert_close(predicted.innovation_covariance()[n], S, SCALED)


def test_a_landmark_whose_points_fall_behind_the_camera_keeps_its_jacobian(course, model) -> None:
    camera, rows = camera_at(course, model, FLEXING, BENT), np.array([4, 0, 7])
    P = uncertain(course, model, FLEXING, 1.0, 3)
    P = inflated(P, -4, 200.0)  # the second landmark's height: 400 m of uncertainty, seen from 70 m
    first = Jacobians().observation(camera, rows, course.landmarks[rows], blocks(P, 3))
    second = Cubature().observation(camera, rows, course.landmarks[rows], blocks(P, 3))
    same = [np.array_equal(getattr(second, f)[1], getattr(first, f)[1]) for f in ("H_vehicle", "H_landmark", "R")]
    assert same == [True] * 3
    np.testing.assert_array_equal(second.expected[1], first.expected[1])
    for n in (0, 2):
        assert np.abs(second.H_landmark[n] - first.H_landmark[n]).max() > 1e-3
        assert np.isfinite(second.innovation_covariance()[n]).all()


def test_cubature_does_not_modify_its_inputs(course, model) -> None:
    camera, rows = camera_at(course, model, FLEXING, BENT), np.array([4, 0, 7])
    P, landmarks = blocks(uncertain(course, model, FLEXING, 1.0, 3), 3), course.landmarks[rows]
    arrays = P.vehicle, P.cross, P.landmarks, landmarks, rows
    before = [a.copy() for a in arrays]
    Cubature().observation(camera, rows, landmarks, P)
    for then, now in zip(before, arrays, strict=True):
        np.testing.assert_array_equal(now, then)


def test_process_by_cubature_becomes_the_jacobians_as_uncertainty_vanishes(course, model) -> None:
    increment = course.increments[2]
    nav = dataclasses.replace(course.true_state(2), gyro_bias=np.zeros(3), accel_bias=np.zeros(3))  # as the increment
    sigma = 1e-4 * np.sqrt(np.diag(uncertain(course, model, EXACT_RIG, 1.0, 0)))
    belief = CovarianceBelief(np.diag(sigma**2), model.nav_dim)
    first, second = (linear.process(model, nav, belief, increment, course.imu) for linear in (Jacobians(), Cubature()))
    moved = propagate(nav, increment, gravity=course.imu.gravity)
    np.testing.assert_array_equal(first.nav.T_map_body.matrix, moved.T_map_body.matrix)
    np.testing.assert_allclose(second.nav.T_map_body.matrix, moved.T_map_body.matrix, rtol=0, atol=1e-8)
    np.testing.assert_allclose(second.nav.v_map, moved.v_map, rtol=0, atol=1e-8)
    np.testing.assert_allclose(second.F, first.F, rtol=0, atol=1e-6)
    scale = np.sqrt(np.outer(np.diag(first.Q), np.diag(first.Q)))
    np.testing.assert_allclose(second.Q / scale, first.Q / scale, rtol=0, atol=1e-6)
    assert second.nav.stamp_ns == increment.stamp_ns


def test_cubature_process_is_the_mean_and_covariance_over_its_points(course, model) -> None:
    nav, increment, none = course.true_state(2), course.increments[2], np.zeros((0, 3))
    P = uncertain(course, model, EXACT_RIG, 3.0, 0)
    process = Cubature().process(model, nav, CovarianceBelief(P, model.nav_dim), increment, course.imu)
    centre, ends = propagate(nav, increment, gravity=course.imu.gravity), []
    for offset in cubature_offsets(np.linalg.cholesky(P)):
        start, _ = model.retract(nav, none, offset)
        ends.append(model.local(centre, propagate(start, increment, gravity=course.imu.gravity)))
    mean, _ = model.retract(centre, none, np.mean(ends, axis=0))
    np.testing.assert_allclose(process.nav.T_map_body.matrix, mean.T_map_body.matrix, rtol=0, atol=1e-11)
    np.testing.assert_allclose(process.nav.v_map, mean.v_map, rtol=0, atol=1e-11)
    from_map, (_, Q) = model.from_map(mean), transition(nav, increment, course.imu)
    expected = np.cov(np.transpose(ends), bias=True) + from_map @ Q @ from_map.T
    sigma = np.sqrt(np.diag(expected))
    error = process.F @ P @ process.F.T + process.Q - expected
    np.testing.assert_allclose(error / np.outer(sigma, sigma), 0.0, rtol=0, atol=SCALED)


def test_process_by_cubature_predicts_monte_carlo(course, model) -> None:
    """2000 draws of a start known to 0.5 m, 0.2 m/s and 3 degrees: mean and covariance at the end.

    The increment's own noise, which the draws lack, is less than a thousandth of this.
    """
    nav, increment, count = course.true_state(2), course.increments[2], 2000
    sigma = np.sqrt(np.diag(uncertain(course, model, EXACT_RIG, 1.0, 0)))
    sigma[6:9] = 0.05
    belief = CovarianceBelief(np.diag(sigma**2), model.nav_dim)
    process = Cubature().process(model, nav, belief, increment, course.imu)
    starts = np.random.default_rng(0).normal(size=(count, model.nav_dim)) * sigma
    ends = []
    for start in starts:
        moved, _ = model.retract(nav, np.zeros((0, 3)), start)
        ends.append(model.local(process.nav, propagate(moved, increment, gravity=course.imu.gravity)))
    P = process.F @ belief.P @ process.F.T + process.Q
    whitened = np.linalg.solve(np.linalg.cholesky(P), np.transpose(ends))
    np.testing.assert_allclose(whitened.mean(axis=1), 0.0, rtol=0, atol=4 / np.sqrt(count))
    np.testing.assert_allclose(np.cov(whitened), np.eye(model.nav_dim), rtol=0, atol=5 * np.sqrt(2 / count))
