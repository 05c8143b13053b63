# SPDX-License-Identifier: Apache-2.0
"""The laws of SO(3), at generic angles, on both sides of the small-angle branches, and near a half turn."""

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.linalg import expm

from uav_vslam.geometry.rotation import (
    SMALL_ANGLE_RAD,
    nearest_rotation,
    quaternion_wxyz_from_rotation,
    rotation_from_quaternion_wxyz,
    rotation_from_rpy,
    rpy_from_rotation,
    skew,
    so3_exp,
    so3_left_jacobian,
    so3_log,
)

Array = NDArray[np.float64]

ROUNDING = 1e-13  # some tens of operations in double precision on numbers of order one
NEAR_PI_ROUNDING = 1e-12  # the axis comes from a quaternion whose w is nearly zero: still full precision
STEP_RAD = 1e-6  # central differences: truncation 1e-12, rounding 1e-10
DIFFERENCE = 1e-8  # of such a derivative

AXES = st.tuples(*[st.floats(-1.0, 1.0)] * 3).filter(lambda a: np.linalg.norm(a) > 0.1)
ANGLES = st.one_of(st.floats(0.0, np.pi - 1e-6), st.floats(-12.0, 0.0).map(lambda power: 10.0**power))
EDGES = [
    0.0,
    1e-300,
    0.5 * SMALL_ANGLE_RAD,
    SMALL_ANGLE_RAD * (1 - 1e-9),
    SMALL_ANGLE_RAD * (1 + 1e-9),
    2.0 * SMALL_ANGLE_RAD * (1 - 1e-9),  # so3_log branches on the half angle
    2.0 * SMALL_ANGLE_RAD * (1 + 1e-9),
    1e-3,
    1e-2,
    0.05 * (1 - 1e-12),  # the branch of (t - sin t) / t^3
    0.05 * (1 + 1e-12),
    np.pi - 1e-3,
    np.pi - 1e-9,
]
SOME_AXIS = np.array([0.48, -0.6, 0.64])


def at_edges(test: Callable[..., None]) -> Callable[..., None]:
    """Test a property on both sides of every branch, in addition to hypothesis's examples."""
    for angle in EDGES:
        test = example(angle * SOME_AXIS)(test)
    return test


@st.composite
def rotation_vectors(draw: st.DrawFn) -> Array:
    axis = np.array(draw(AXES))
    return np.asarray(draw(ANGLES) * axis / np.linalg.norm(axis))


@at_edges
@given(rotation_vectors())
def test_exp_is_the_matrix_exponential(xi: Array) -> None:
    np.testing.assert_allclose(so3_exp(xi), expm(skew(xi)), rtol=0, atol=ROUNDING)


@at_edges
@given(rotation_vectors())
def test_exp_gives_a_rotation(xi: Array) -> None:
    R = so3_exp(xi)
    np.testing.assert_allclose(R @ R.T, np.eye(3), rtol=0, atol=ROUNDING)
    assert np.linalg.det(R) == pytest.approx(1.0, abs=ROUNDING)


@at_edges
@given(rotation_vectors())
def test_log_inverts_exp(xi: Array) -> None:
    np.testing.assert_allclose(so3_log(so3_exp(xi)), xi, rtol=NEAR_PI_ROUNDING, atol=NEAR_PI_ROUNDING)


@given(AXES)
def test_exp_inverts_log_at_and_beyond_a_half_turn(axis: tuple[float, ...]) -> None:
    half_turn = np.array(axis) / np.linalg.norm(axis) * np.pi
    for beyond in (0.0, 1e-9, 0.3):
        R = so3_exp(half_turn * (1.0 + beyond))
        back = so3_log(R)
        assert np.linalg.norm(back) <= np.pi + ROUNDING
        np.testing.assert_allclose(so3_exp(back), R, rtol=0, atol=NEAR_PI_ROUNDING)


@at_edges
@given(rotation_vectors())
def test_left_jacobian_is_the_derivative_of_exp(xi: Array) -> None:
    columns = []
    for axis in np.eye(3):
        plus, minus = so3_exp(xi + STEP_RAD * axis), so3_exp(xi - STEP_RAD * axis)
        columns.append(so3_log(plus @ minus.T) / (2.0 * STEP_RAD))
    np.testing.assert_allclose(so3_left_jacobian(xi), np.column_stack(columns), rtol=0, atol=DIFFERENCE)


@at_edges
@given(rotation_vectors())
def test_left_jacobian_is_the_mean_of_exp_along_the_turn(xi: Array) -> None:
    """J_l(xi) = integral of Exp(s xi) over s in [0, 1], here by 24-point Gauss quadrature: exact to rounding."""
    nodes, weights = np.polynomial.legendre.leggauss(24)
    mean = np.einsum("k,kij->ij", 0.5 * weights, so3_exp(0.5 * (nodes[:, None] + 1.0) * xi))
    # (t - sin t) / t^3 just above 0.05 rad has lost four of sixteen digits, but is multiplied by t^2.
    np.testing.assert_allclose(so3_left_jacobian(xi), mean, rtol=0, atol=ROUNDING)


@at_edges
@given(rotation_vectors())
def test_left_and_right_jacobian_differ_by_the_rotation(xi: Array) -> None:
    np.testing.assert_allclose(so3_left_jacobian(xi), so3_exp(xi) @ so3_left_jacobian(-xi), rtol=0, atol=ROUNDING)


@at_edges
@given(rotation_vectors())
def test_quaternion_and_rotation_are_inverse_and_w_is_never_negative(xi: Array) -> None:
    R = so3_exp(xi)
    q = quaternion_wxyz_from_rotation(R)
    assert q[0] >= 0
    assert np.linalg.norm(q) == pytest.approx(1.0, abs=ROUNDING)
    np.testing.assert_allclose(rotation_from_quaternion_wxyz(q), R, rtol=0, atol=ROUNDING)
    np.testing.assert_allclose(rotation_from_quaternion_wxyz(-3.0 * q), R, rtol=0, atol=ROUNDING)


@pytest.mark.parametrize("axis", range(3))
def test_half_turns_about_each_axis_have_the_textbook_quaternion(axis: int) -> None:
    expected = np.zeros(4)
    expected[1 + axis] = 1.0
    R = 2.0 * np.outer(expected[1:], expected[1:]) - np.eye(3)
    np.testing.assert_array_equal(quaternion_wxyz_from_rotation(R), expected)


def test_a_quarter_turn_left_about_z_has_the_hamilton_quaternion() -> None:
    R = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    np.testing.assert_allclose(
        quaternion_wxyz_from_rotation(R), [np.sqrt(0.5), 0, 0, np.sqrt(0.5)], rtol=0, atol=ROUNDING
    )


@pytest.mark.parametrize("bad", [[0.0, 0.0, 0.0, 0.0], [1e-7, 0.0, 0.0, 0.0], [np.nan, 0.0, 0.0, 1.0]])
def test_a_zero_quaternion_is_rejected(bad: list[float]) -> None:
    with pytest.raises(ValueError, match="zero norm"):
        rotation_from_quaternion_wxyz([[1.0, 0.0, 0.0, 0.0], bad])


ANGLE = st.floats(-np.pi + 1e-6, np.pi - 1e-6)


@given(ANGLE, st.floats(-1.55, 1.55), ANGLE)
def test_roll_pitch_yaw_return_from_the_rotation(roll: float, pitch: float, yaw: float) -> None:
    # Near the singular pitch the angles lose digits by 1 / cos(pitch), at most a factor 50 here.
    np.testing.assert_allclose(
        rpy_from_rotation(rotation_from_rpy(roll, pitch, yaw)), [roll, pitch, yaw], rtol=0, atol=1e-11
    )


@pytest.mark.parametrize("mirrored", [False, True])
def test_no_rotation_is_nearer_to_a_matrix_than_the_nearest(mirrored: bool) -> None:
    rng = np.random.default_rng(1)
    matrix = rng.normal(0.0, 1.0, (3, 3))
    matrix *= 1.0 if (np.linalg.det(matrix) < 0.0) == mirrored else -1.0
    R = nearest_rotation(matrix)
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=ROUNDING)
    assert np.linalg.det(R) > 0.0
    others = R @ so3_exp(rng.normal(0.0, 1.0, (200, 3)))
    assert np.linalg.norm(R - matrix) < np.linalg.norm(others - matrix, axis=(1, 2)).min()


def test_rpy_turns_flu_axes_the_right_way() -> None:
    left_bank = rotation_from_rpy(-0.3, 0.0, 0.0)
    assert (left_bank @ [0.0, 1.0, 0.0])[2] < 0  # the left wing goes down
    nose_up = rotation_from_rpy(0.0, -0.2, 0.0)
    assert (nose_up @ [1.0, 0.0, 0.0])[2] > 0
    np.testing.assert_allclose(
        rotation_from_rpy(0.0, 0.0, np.pi / 2) @ [1.0, 0.0, 0.0], [0, 1, 0], rtol=0, atol=ROUNDING
    )


@settings(max_examples=20)
@given(st.lists(rotation_vectors(), min_size=1, max_size=5))
def test_functions_are_vectorised_over_rows(vectors: list[Array]) -> None:
    xi = np.array(vectors)
    R = so3_exp(xi)
    for function, batch in [(so3_exp, xi), (so3_left_jacobian, xi), (so3_log, R), (rpy_from_rotation, R), (skew, xi)]:
        np.testing.assert_array_equal(function(batch), np.array([function(row) for row in batch]))


@pytest.mark.parametrize(
    ("function", "shape"),
    [
        (skew, (0, 3)),
        (so3_exp, (0, 3)),
        (so3_left_jacobian, (0, 3)),
        (so3_log, (0, 3, 3)),
        (quaternion_wxyz_from_rotation, (0, 3, 3)),
        (rotation_from_quaternion_wxyz, (0, 4)),
        (rpy_from_rotation, (0, 3, 3)),
    ],
)
def test_no_rows_give_no_rows(function, shape) -> None:
    assert len(function(np.zeros(shape))) == 0


@given(rotation_vectors(), rotation_vectors())
def test_skew_is_the_cross_product(a: Array, b: Array) -> None:
    np.testing.assert_allclose(skew(a) @ b, np.cross(a, b), rtol=0, atol=ROUNDING)
