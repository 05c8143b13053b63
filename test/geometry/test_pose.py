# SPDX-License-Identifier: Apache-2.0
"""Rigid transforms compose, invert and convert as their names say."""

import numpy as np
import pytest

from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.rotation import so3_exp

ROUNDING = 1e-13  # a few products of numbers of order one
T_A_B = Pose(so3_exp([0.3, -0.2, 1.0]), np.array([1.0, 2.0, 3.0]))
T_B_C = Pose(so3_exp([-0.5, 0.1, 0.4]), np.array([-4.0, 0.5, 2.0]))
POINTS_C = np.array([[0.1, 0.2, 0.3], [-1.0, 4.0, 2.0]])


def test_composition_maps_points_through_both() -> None:
    np.testing.assert_allclose(
        (T_A_B @ T_B_C).apply(POINTS_C), T_A_B.apply(T_B_C.apply(POINTS_C)), rtol=0, atol=ROUNDING
    )
    np.testing.assert_allclose((T_A_B @ T_B_C).matrix, T_A_B.matrix @ T_B_C.matrix, rtol=0, atol=ROUNDING)


def test_a_transform_and_its_inverse_cancel() -> None:
    np.testing.assert_allclose((T_A_B @ T_A_B.inverse()).matrix, np.eye(4), rtol=0, atol=ROUNDING)
    np.testing.assert_allclose((T_A_B.inverse() @ T_A_B).matrix, np.eye(4), rtol=0, atol=ROUNDING)
    np.testing.assert_array_equal(Pose.identity().matrix, np.eye(4))


def test_matrix_and_quaternion_forms_return_the_same_transform() -> None:
    np.testing.assert_array_equal(Pose.from_matrix(T_A_B.matrix).matrix, T_A_B.matrix)
    back = Pose.from_quaternion_wxyz(T_A_B.quaternion_wxyz, T_A_B.t)
    np.testing.assert_allclose(back.matrix, T_A_B.matrix, rtol=0, atol=ROUNDING)


def test_a_transform_built_from_a_matrix_does_not_share_its_memory() -> None:
    T = np.eye(4)
    pose = Pose.from_matrix(T)
    T[:] = 7.0
    np.testing.assert_array_equal(pose.matrix, np.eye(4))


@pytest.mark.parametrize("shape", [(3,), (0, 3), (5, 3), (2, 4, 3)])
def test_points_of_any_leading_shape_keep_it(shape: tuple[int, ...]) -> None:
    assert T_A_B.apply(np.ones(shape)).shape == shape


def test_a_step_turns_and_shifts_along_the_outer_axes() -> None:
    moved = T_A_B.moved([1.0, 0.0, -2.0, 0.0, 0.0, np.pi / 2])
    np.testing.assert_allclose(moved.t, [2.0, 2.0, 1.0])
    np.testing.assert_allclose(
        moved.R, np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]) @ T_A_B.R, atol=1e-15
    )
