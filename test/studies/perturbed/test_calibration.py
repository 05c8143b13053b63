# SPDX-License-Identifier: Apache-2.0
"""A condition's error is the one that its name says, as large as it says, and nothing else."""

import dataclasses

import numpy as np
import pytest

from uav_vslam.geometry.rotation import so3_log
from uav_vslam.simulation.rig import kagaru_rig
from uav_vslam.studies.perturbed.calibration import (
    ALL,
    ATTITUDE_DEG,
    BASELINE,
    BOARD,
    DISPARITIES,
    EXACT,
    FIELDS,
    FOCAL,
    PRINCIPAL_POINT_PX,
    TIME_OFFSET_S,
    CalibrationError,
    errors_of,
)

RIG = kagaru_rig()
SIGMAS = {
    "focal": FOCAL,
    "principal_point_px": PRINCIPAL_POINT_PX,
    "attitude_rad": np.deg2rad(ATTITUDE_DEG),
    "baseline": BASELINE,
    "time_offset_s": TIME_OFFSET_S,
}
SPREAD = 0.05  # of a standard deviation from 600 draws: 3 % is one sigma


def wrong_fields(error):
    return {name for name in SIGMAS if np.any(getattr(error, name))}


def test_each_condition_has_its_own_error_and_the_last_has_all():
    errors = errors_of(7)
    assert {name: wrong_fields(error) for name, error in errors.items() if name in FIELDS} == {
        name: set(fields) for name, fields in FIELDS.items()
    }
    assert wrong_fields(errors[ALL]) == set(SIGMAS)
    for condition, (field, *others) in {name: fields for name, fields in FIELDS.items() if fields}.items():
        if not others:
            np.testing.assert_array_equal(getattr(errors[condition], field), getattr(errors[ALL], field))


def test_constant_errors_shift_the_disparity_alone():
    point = np.array([[3.0, -2.0, 70.0]])
    for condition, error_px in DISPARITIES.items():
        error = errors_of(7)[condition]
        assert wrong_fields(error) == set()
        shift = (error.applied(RIG).project(point) - RIG.project(point))[0]
        np.testing.assert_allclose(np.abs(shift), [0.0, 0.0, 0.0, error_px], atol=0.01)  # of Kagaru's rig: in v


def test_errors_have_the_stated_size_and_no_mean_and_belong_to_the_seed():
    for field, sigma in SIGMAS.items():
        drawn = np.array([getattr(errors_of(seed)[ALL], field) for seed in range(600)])
        assert np.sqrt(np.mean(drawn**2)) == pytest.approx(sigma, rel=2 * SPREAD)
        assert np.abs(drawn.mean(axis=0)).max() < 4 * sigma / np.sqrt(600)
    np.testing.assert_array_equal(errors_of(3)[ALL].focal, errors_of(3)[ALL].focal)


def test_the_exact_calibration_is_the_rig():
    points = np.array([[0.0, 0.0, 70.0], [12.0, -9.0, 60.0]])
    assumed = errors_of(1)[EXACT].applied(RIG)
    np.testing.assert_allclose(assumed.project(points), RIG.project(points), atol=1e-9)


def test_the_told_rig_is_wrong_by_the_error():
    error = dataclasses.replace(errors_of(5)[ALL], baseline=0.01, focal=np.array([1e-3, -2e-3]))
    assumed = error.applied(RIG)
    assert assumed.baseline_m == pytest.approx(1.01 * RIG.baseline_m)
    assert (assumed.left.fx / RIG.left.fx, assumed.right.fy / RIG.right.fy) == pytest.approx((1.001, 0.998))
    shift = [assumed.right.cx - RIG.right.cx, assumed.right.cy - RIG.right.cy]
    np.testing.assert_allclose(shift, error.principal_point_px[1], atol=1e-9)
    np.testing.assert_allclose(so3_log(RIG.T_body_right.R.T @ assumed.T_body_right.R), error.attitude_rad, atol=1e-12)
    np.testing.assert_array_equal(assumed.T_body_left.matrix, RIG.T_body_left.matrix)


def test_a_wrong_attitude_about_the_baselines_normal_shifts_the_disparity():
    assumed = CalibrationError(attitude_rad=np.array([np.deg2rad(0.01), 0.0, 0.0])).applied(RIG)
    point = np.array([0.0, 0.0, 70.0])
    u, v = (assumed.project(point) - RIG.project(point))[2:]
    assert abs(v) == pytest.approx(np.deg2rad(0.01) * RIG.right.fy, rel=0.01)  # 0.29 px of 18
    assert abs(u) < 0.02


@pytest.mark.slow
def test_a_board_leaves_large_errors_that_make_up_for_each_other():
    """So a rig that is drawn from the reported standard deviations alone is far worse than the calibrated one."""
    point = np.array([0.0, 0.0, 70.0])
    shifts, disparities = [], []
    for seed in range(6):
        assumed = errors_of(seed)[BOARD].applied(RIG)
        shifts.append([assumed.left.cy - RIG.left.cy, assumed.right.cy - RIG.right.cy])
        pixels = assumed.project(point) - RIG.project(point)
        disparities.append(pixels[3] - pixels[1])
        assert assumed.baseline_m == pytest.approx(RIG.baseline_m, rel=2e-3)
        np.testing.assert_array_equal(assumed.T_body_left.matrix, RIG.T_body_left.matrix)
    assert np.sqrt(np.mean(np.square(shifts))) > 0.3
    assert np.sqrt(np.mean(np.square(disparities))) < 0.15


@pytest.mark.slow
def test_a_calibration_belongs_to_its_seed():
    first, again, other = (errors_of(seed)[BOARD].applied(RIG) for seed in (1, 1, 2))
    assert again.left.fx == pytest.approx(first.left.fx, rel=1e-8)  # OpenCV sums in any order
    assert abs(other.left.fx / first.left.fx - 1.0) > 1e-6
