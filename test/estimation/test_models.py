# SPDX-License-Identifier: Apache-2.0
"""Each model's coordinates agree with its retraction; the right-invariant one is the exponential of a matrix group."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from map_error import map_error
from numpy.typing import NDArray
from scipy.linalg import expm

from uav_vslam.estimation.models import MODELS, POSE, RightInvariant15, chart_transport, difference
from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.rotation import rotation_from_rpy, skew, so3_exp
from uav_vslam.ins.propagation import NAV_DIM, POSITION, ROTATION, VELOCITY
from uav_vslam.types import NavState

Array = NDArray[np.float64]

STEP = 1e-6  # of each coordinate, central differences
DIFFERENCE = 1e-7  # of such a derivative of numbers of order 20
ROUNDING = 1e-11  # of positions of order 100 m

NAV = NavState(
    7,
    Pose(so3_exp([0.3, -0.2, 1.1]), np.array([40.0, -15.0, 70.0])),
    np.array([19.0, 4.0, -1.0]),
    *np.full((2, 3), 0.01),
)
LANDMARKS = np.array([[45.0, -10.0, 1.0], [20.0, -30.0, -2.0], [60.0, 5.0, 0.5]])


@pytest.fixture(scope="module", params=sorted(MODELS))
def model(request: pytest.FixtureRequest):
    return MODELS[request.param]()


def test_to_map_is_the_derivative_of_the_retraction(model) -> None:
    m = model.nav_dim
    numeric = np.zeros((NAV_DIM, m))
    for k in range(m):
        step = np.zeros(m + 9)
        step[k] = STEP
        plus, _ = model.retract(NAV, LANDMARKS, step)
        minus, _ = model.retract(NAV, LANDMARKS, -step)
        numeric[:, k] = (map_error(plus, NAV) - map_error(minus, NAV)) / (2 * STEP)
    np.testing.assert_allclose(model.to_map(NAV), numeric, rtol=0, atol=DIFFERENCE)


def test_landmark_coordinates_are_plain_differences_to_first_order(model) -> None:
    m = model.nav_dim
    for k in range(m + 9):
        step = np.zeros(m + 9)
        step[k] = STEP
        _, plus = model.retract(NAV, LANDMARKS, step)
        _, minus = model.retract(NAV, LANDMARKS, -step)
        expected = np.eye(m + 9)[m:, k].reshape(-1, 3)
        np.testing.assert_allclose((plus - minus) / (2 * STEP), expected, rtol=0, atol=DIFFERENCE)


def test_from_map_inverts_to_map(model) -> None:
    np.testing.assert_allclose(model.from_map(NAV) @ model.to_map(NAV), np.eye(model.nav_dim), rtol=0, atol=1e-13)


def test_a_zero_correction_changes_nothing(model) -> None:
    nav, landmarks = model.retract(NAV, LANDMARKS, np.zeros(model.nav_dim + 9))
    np.testing.assert_allclose(nav.T_map_body.matrix, NAV.T_map_body.matrix, rtol=0, atol=1e-13)
    np.testing.assert_allclose(nav.v_map, NAV.v_map, rtol=0, atol=1e-13)
    np.testing.assert_allclose(landmarks, LANDMARKS, rtol=0, atol=1e-13)


def test_a_state_without_landmarks_is_corrected_as_well(model) -> None:
    _, landmarks = model.retract(NAV, np.zeros((0, 3)), np.full(model.nav_dim, 0.01))
    assert landmarks.shape == (0, 3)


def test_retraction_modifies_no_input(model) -> None:
    delta = np.full(model.nav_dim + 9, 0.1)
    before = NAV.T_map_body.matrix.copy(), LANDMARKS.copy(), delta.copy()
    model.retract(NAV, LANDMARKS, delta)
    for then, now in zip(before, (NAV.T_map_body.matrix, LANDMARKS, delta), strict=True):
        np.testing.assert_array_equal(then, now)


# The group SE_{2+N}(3): rotation and 2+N vectors (position, velocity, landmarks), as (5+N) x (5+N) matrices.


def group_element(nav: NavState, landmarks: Array) -> Array:
    X = np.eye(5 + len(landmarks))
    X[:3, :3] = nav.T_map_body.R
    X[:3, 3:] = np.column_stack([nav.T_map_body.t, nav.v_map, *landmarks])
    return X


def algebra_element(nav: NavState, landmarks: Array, delta: Array) -> Array:
    """Return the right-invariant error with the plain differences `delta`: dx = rho + xi x x for each vector x."""
    xi = delta[ROTATION]
    vectors = np.vstack([nav.T_map_body.t, nav.v_map, landmarks])
    plain = np.vstack([delta[POSITION], delta[VELOCITY], delta[NAV_DIM:].reshape(-1, 3)])
    A = np.zeros((5 + len(landmarks),) * 2)
    A[:3, :3] = skew(xi)
    A[:3, 3:] = (plain - np.cross(xi, vectors)).T
    return A


DELTAS = st.builds(
    lambda xi, rest: np.concatenate([rest[:6], xi, rest[6:]]),
    st.one_of(
        st.lists(st.floats(-1.5, 1.5), min_size=3, max_size=3).map(np.array),
        st.lists(st.floats(-1e-7, 1e-7), min_size=3, max_size=3).map(np.array),
    ),
    st.lists(st.floats(-5.0, 5.0), min_size=21, max_size=21).map(np.array),
)


@given(DELTAS)
def test_right_invariant_retraction_is_the_exponential_of_the_group(delta: Array) -> None:
    expected = expm(algebra_element(NAV, LANDMARKS, delta)) @ group_element(NAV, LANDMARKS)
    nav, landmarks = RightInvariant15().retract(NAV, LANDMARKS, delta)
    np.testing.assert_allclose(group_element(nav, landmarks), expected, rtol=0, atol=ROUNDING)
    np.testing.assert_allclose(nav.gyro_bias - NAV.gyro_bias, delta[9:12], rtol=0, atol=ROUNDING)
    np.testing.assert_allclose(nav.accel_bias - NAV.accel_bias, delta[12:15], rtol=0, atol=ROUNDING)


@given(DELTAS)
def test_difference_inverts_the_right_invariant_retraction(delta: Array) -> None:
    nav, landmarks = RightInvariant15().retract(NAV, LANDMARKS, delta)
    np.testing.assert_allclose(difference(NAV, LANDMARKS, nav, landmarks), delta, rtol=0, atol=100 * ROUNDING)


@given(st.integers(0, 2**32 - 1), st.integers(0, 4), st.integers(0, 3))
def test_chart_transport_is_the_change_of_chart_to_a_moved_mean(seed: int, rig_rows: int, count: int) -> None:
    """T = I - B E^T is dx+ = dx - [x+ - x]x xi for position, velocity and landmarks alone."""
    rng = np.random.default_rng(seed)
    moved_p, moved_v, moved_l = rng.normal(0, 2, 3), rng.normal(0, 1, 3), rng.normal(0, 2, (count, 3))
    vehicle = NAV_DIM + rig_rows
    expected = np.eye(vehicle + 3 * count)
    expected[POSITION, ROTATION] = -skew(moved_p)
    expected[VELOCITY, ROTATION] = -skew(moved_v)
    expected[vehicle:, ROTATION] = -skew(moved_l).reshape(-1, 3)
    T = np.eye(vehicle + 3 * count)
    T[:, ROTATION] -= chart_transport(vehicle, moved_p, moved_v, moved_l)
    np.testing.assert_array_equal(T, expected)


def test_chart_transport_without_motion_is_zero() -> None:
    np.testing.assert_array_equal(chart_transport(15, np.zeros(3), np.zeros(3), np.zeros((0, 3))), np.zeros((15, 3)))


@given(DELTAS)
def test_local_inverts_the_retraction_of_every_model(model, delta: Array) -> None:
    step = delta[: model.nav_dim] * (0.1 if model.nav_dim == 9 else 1.0)  # roll, pitch, yaw: away from the pole
    nav, _ = model.retract(NAV, np.zeros((0, 3)), step)
    found = model.local(NAV, nav)
    np.testing.assert_allclose(found, step, rtol=0, atol=100 * ROUNDING)
    again, _ = model.retract(NAV, np.zeros((0, 3)), found)
    np.testing.assert_allclose(again.T_map_body.matrix, nav.T_map_body.matrix, rtol=0, atol=100 * ROUNDING)


def test_local_wraps_the_yaw(model) -> None:
    """A yaw of 179 and one of -179 degrees differ by two degrees."""
    poses = [Pose(rotation_from_rpy(0.05, 0.1, np.deg2rad(yaw)), NAV.T_map_body.t) for yaw in (179.0, -179.0)]
    start, end = (dataclasses.replace(NAV, T_map_body=pose) for pose in poses)
    turn = model.local(start, end)[6:9]
    assert np.linalg.norm(turn) == pytest.approx(np.deg2rad(2.0), rel=1e-9)


PERTURBATIONS = st.sampled_from([1.0, 1e-2, 1.1e-4, 0.9e-4, 1e-6, 1e-9, 0.0])  # on both sides of the series' limit


@settings(max_examples=40)
@given(st.integers(0, 2**32 - 1), PERTURBATIONS)
def test_perturbed_arms_are_landmarks_in_the_retracted_body_frame(model, seed: int, size: float) -> None:
    """Finite and tiny rotations, in batches: 4 errors of 3 landmarks each."""
    rng = np.random.default_rng(seed)
    pose = rng.normal(size=(3, 4, 6)) * np.repeat([5.0, 0.3 * size], 3)
    landmark = rng.normal(0, 5.0, (3, 4, 3))
    arms = (LANDMARKS - NAV.T_map_body.t)[:, None, :]
    seen = model.perturbed_arms(NAV, arms, pose, landmark)
    assert seen.shape == (3, 4, 3)
    for k, n in np.ndindex(3, 4):
        delta = np.zeros(model.nav_dim + 9)
        delta[POSE] = pose[k, n]
        delta[model.nav_dim + 3 * k : model.nav_dim + 3 * k + 3] = landmark[k, n]
        nav, landmarks = model.retract(NAV, LANDMARKS, delta)
        expected = nav.T_map_body.R.T @ (landmarks[k] - nav.T_map_body.t)
        np.testing.assert_allclose(seen[k, n], expected, rtol=0, atol=10 * ROUNDING)


def test_perturbed_arms_accept_read_only_arrays(model) -> None:
    arms, pose, landmark = (np.broadcast_to(x, (4, 1, k)) for x, k in ((1.0, 3), (0.1, 6), (2.0, 3)))
    assert model.perturbed_arms(NAV, arms, pose, landmark).shape == (4, 1, 3)


def test_perturbed_arms_of_no_landmarks_are_empty(model) -> None:
    none = model.perturbed_arms(NAV, np.zeros((0, 1, 3)), np.zeros((0, 18, 6)), np.zeros((0, 18, 3)))
    assert none.shape == (0, 18, 3)


def test_euler9_has_the_thesis_states() -> None:
    model = MODELS["euler9"]()
    delta = np.zeros(9)
    delta[3:6] = [1.0, 0.0, 0.0]  # 1 m/s along the body's x axis
    nav, _ = model.retract(NAV, np.zeros((0, 3)), delta)
    np.testing.assert_allclose(nav.v_map - NAV.v_map, NAV.T_map_body.R[:, 0], rtol=0, atol=1e-13)
    assert nav == dataclasses.replace(nav, gyro_bias=NAV.gyro_bias, accel_bias=NAV.accel_bias)
