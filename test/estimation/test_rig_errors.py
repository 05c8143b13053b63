# SPDX-License-Identifier: Apache-2.0
"""Which rig errors are states, how they change the rig, and how they drift."""

import dataclasses

import numpy as np
import pytest

from uav_vslam.config import EXACT_RIG, RigConfig
from uav_vslam.estimation.rig_errors import RigErrors, RigState
from uav_vslam.estimation.turning import Turning
from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.rotation import so3_exp
from uav_vslam.simulation.rig import kagaru_rig, rotated_right
from uav_vslam.types import NavState

RIG = kagaru_rig()
EXACT = EXACT_RIG
FLEXING = RigConfig(
    flexing=True,
    attitude_sigma_deg=0.05,
    vibration_sigma_deg=0.02,
    disparity_sigma_px=0.0,
    focal_ratio_sigma=0.0,
    time_offset_sigma_s=0.01,
)
EVERYTHING = dataclasses.replace(FLEXING, disparity_sigma_px=0.2, focal_ratio_sigma=1e-3)
NAV = NavState(
    7, Pose(so3_exp([0.3, -0.2, 1.1]), np.array([40.0, -15.0, 70.0])), np.array([19.0, 4.0, -1.0]), *np.zeros((2, 3))
)


@pytest.mark.parametrize(
    ("config", "sizes", "sigma"),
    [
        (EXACT, [0, 0, 0, 0, 0], []),
        (
            dataclasses.replace(EXACT, rigid_sigma_deg=0.002, epipolar_sigma_deg=0.0),
            [3, 0, 0, 0, 0],
            np.deg2rad([0.002] * 3),
        ),
        (EVERYTHING, [3, 3, 1, 1, 1], [*np.deg2rad([0.05] * 3 + [0.02] * 3), 0.2, 1e-3, 0.01]),
        (dataclasses.replace(FLEXING, vibration_sigma_deg=0.0), [3, 0, 0, 0, 1], [*np.deg2rad([0.05] * 3), 0.01]),
        (dataclasses.replace(FLEXING, attitude_sigma_deg=0.0), [0, 3, 0, 0, 1], [*np.deg2rad([0.02] * 3), 0.01]),
        (dataclasses.replace(EXACT, disparity_sigma_px=0.3), [0, 0, 1, 0, 0], [0.3]),
        (dataclasses.replace(EXACT, focal_ratio_sigma=0.002), [0, 0, 0, 1, 0], [0.002]),
        (dataclasses.replace(EXACT, time_offset_sigma_s=0.02), [0, 0, 0, 0, 1], [0.02]),
    ],
)
def test_states_are_the_errors_of_nonzero_configured_sigma(
    config: RigConfig, sizes: list[int], sigma: list[float]
) -> None:
    errors = RigErrors(RIG, config, 15)
    parts = errors.attitude, errors.vibration, errors.disparity, errors.focal_ratio, errors.time_offset
    rows = [range(100)[part] for part in parts]
    assert [len(r) for r in rows] == sizes
    assert [k for r in rows for k in r] == list(range(15, 15 + errors.dim)) == list(range(100)[errors.rows])
    np.testing.assert_allclose(np.sqrt(np.diag(errors.prior_covariance)), sigma, rtol=1e-12)


@pytest.mark.parametrize("roll_deg", [0.0, 45.0, 90.0])
def test_a_rigid_rig_is_uncertain_off_the_epipolar_lines_and_hardly_along_the_disparity(roll_deg: float) -> None:
    """For cameras that are turned about their optical axes; an angle's shift of a far point tells which it is."""
    turn = Pose(so3_exp([0.0, 0.0, np.deg2rad(roll_deg)]), np.zeros(3))
    rig = dataclasses.replace(RIG, T_body_left=RIG.T_body_left @ turn, T_body_right=RIG.T_body_right @ turn)
    errors = RigErrors(rig, dataclasses.replace(EXACT, rigid_sigma_deg=0.001, epipolar_sigma_deg=0.1), 15)
    ahead = rig.T_right_left.inverse().apply(np.array([[0.0, 0.0, 1e6]]))
    shift = errors.pixel_jacobian(rig, ahead)[0, 2:]
    axes = rig.disparity_axis, np.array([-rig.disparity_axis[1], rig.disparity_axis[0]])
    sigma_px = [np.sqrt(axis @ shift @ errors.prior_covariance @ shift.T @ axis) for axis in axes]
    np.testing.assert_allclose(sigma_px, rig.right.fx * np.deg2rad([0.001, 0.1]), rtol=0.02)


def test_only_the_attitude_of_a_flexing_rig_has_a_random_walk() -> None:
    errors = RigErrors(RIG, dataclasses.replace(EVERYTHING, attitude_walk_deg=0.001), 15)
    expected = [np.deg2rad(0.001) ** 2 * 4.0] * 3 + [0.0] * 6
    np.testing.assert_allclose(errors.noise_variance(4.0), expected, rtol=1e-12)
    np.testing.assert_array_equal(RigErrors(RIG, RigConfig(rigid_sigma_deg=0.01), 15).noise_variance(4.0), np.zeros(6))
    assert RigErrors(RIG, EXACT, 15).noise_variance(4.0).shape == (0,)


def test_a_rig_without_errors_is_the_calibrated_one() -> None:
    assert RigErrors(RIG, FLEXING, 15).rig(RigState()) is RIG


def test_attitude_and_vibration_turn_the_right_camera_as_the_simulation_does() -> None:
    state = RigState(np.array([1e-3, -2e-3, 3e-3]), np.array([-4e-4, 5e-4, 6e-4]))
    found, expected = RigErrors(RIG, FLEXING, 15).rig(state), rotated_right(RIG, state.attitude + state.vibration)
    np.testing.assert_allclose(found.T_body_right.matrix, expected.T_body_right.matrix, rtol=0, atol=1e-15)
    assert found.T_body_left is RIG.T_body_left


@pytest.mark.parametrize("shift_px", [0.3, -0.2])
def test_a_disparity_error_moves_right_points_along_the_epipolar_line(shift_px: float) -> None:
    errors = RigErrors(RIG, dataclasses.replace(EXACT, disparity_sigma_px=0.2), 15)
    rig = errors.rig(RigState(disparity_px=shift_px))
    points = np.array([[0.0, 0.0, 50.0], [0.0, 0.0, 70.0]])
    moved, near_less_far = rig.project(points) - RIG.project(points), np.diff(RIG.project(points)[:, 2:], axis=0)[0]
    np.testing.assert_array_equal(moved[:, :2], 0.0)
    np.testing.assert_allclose(np.linalg.norm(moved[:, 2:], axis=1), abs(shift_px), rtol=1e-9)
    cross = near_less_far[0] * moved[:, 3] - near_less_far[1] * moved[:, 2]
    np.testing.assert_allclose(cross / np.linalg.norm(near_less_far), 0.0, atol=0.01 * abs(shift_px))


def test_retraction_adds_each_states_rows() -> None:
    errors = RigErrors(RIG, EVERYTHING, 2)
    delta = np.arange(20.0)  # rows 2 to 10 are the rig's
    before = RigState(np.ones(3), np.ones(3), disparity_px=2.0, focal_ratio=3.0, time_offset_s=1.0)
    state = errors.retract(before, delta)
    np.testing.assert_array_equal(errors.calibration(state), [*state.attitude, state.disparity_px, state.focal_ratio])
    np.testing.assert_array_equal(delta[errors.calibrated], [2.0, 3.0, 4.0, 8.0, 9.0])
    np.testing.assert_array_equal(state.attitude, [3.0, 4.0, 5.0])
    np.testing.assert_array_equal(state.vibration, [6.0, 7.0, 8.0])
    assert (state.disparity_px, state.focal_ratio, state.time_offset_s) == (10.0, 12.0, 11.0)
    calibrated = RigState()
    assert RigErrors(RIG, EXACT, 2).retract(calibrated, delta) == calibrated


def test_only_the_vibration_is_reset() -> None:
    errors = RigErrors(RIG, FLEXING, 15)
    state = errors.reset_vibration(RigState(np.ones(3), np.ones(3), time_offset_s=0.5))
    np.testing.assert_array_equal(state.vibration, np.zeros(3))
    np.testing.assert_array_equal(state.attitude, np.ones(3))
    assert state.time_offset_s == 0.5


def test_the_exposure_is_extrapolated_by_the_motion() -> None:
    errors, turning = RigErrors(RIG, FLEXING, 15), Turning(np.array([0.1, -0.2, 0.3]), np.array([4.0, -3.0, 2.0]))
    later = errors.at_exposure(RigState(time_offset_s=0.01), NAV, turning)
    np.testing.assert_allclose(later.T_map_body.t, NAV.T_map_body.t + 0.01 * NAV.v_map, rtol=0, atol=1e-14)
    np.testing.assert_allclose(
        later.T_map_body.R, so3_exp(turning.rotation(0.01)) @ NAV.T_map_body.R, rtol=0, atol=1e-15
    )
    assert (later.stamp_ns, later.v_map is NAV.v_map) == (NAV.stamp_ns, True)
    assert errors.at_exposure(RigState(), NAV, turning) is NAV


def test_no_points_give_an_empty_jacobian() -> None:
    errors = RigErrors(RIG, FLEXING, 15)
    assert errors.pixel_jacobian(RIG, np.zeros((0, 3))).shape == (0, 4, 7)
