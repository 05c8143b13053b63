# SPDX-License-Identifier: Apache-2.0
"""Where the cameras look at an exposure that is milliseconds off its stamp."""

import dataclasses

import numpy as np
import pytest

from uav_vslam.config import RigConfig
from uav_vslam.config.rig import EXACT_RIG
from uav_vslam.estimation.past_poses import PastPoses
from uav_vslam.estimation.rig_errors import RigErrors, RigState
from uav_vslam.estimation.turning import Gusts, Turning
from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.rotation import so3_exp, so3_log
from uav_vslam.types import NavState

RATE, SLOPE = np.array([0.2, -0.1, 0.3]), np.array([4.0, -3.0, 2.0])
TURNING = Turning(RATE, SLOPE)


@pytest.mark.parametrize("later_s", [-0.03, 0.0, 0.02])
def test_the_rotation_is_the_integral_of_the_rate(later_s: float) -> None:
    steps = 2000
    R = np.eye(3)
    for k in range(steps):
        R = so3_exp(TURNING.rate(later_s * (k + 0.5) / steps) * later_s / steps) @ R
    np.testing.assert_allclose(TURNING.rotation(later_s), so3_log(R), rtol=0, atol=2e-6)  # its axis turns, too
    np.testing.assert_allclose(TURNING.rate(later_s), RATE + later_s * SLOPE, rtol=0, atol=1e-15)


def test_the_present_pose_and_past_ones_are_moved_alike(course) -> None:
    nav = NavState(5, Pose(so3_exp(RATE), RATE), np.array([20.0, 1.0, -0.5]), np.zeros(3), np.zeros(3))
    errors = RigErrors(course.rig, RigConfig(), 15)
    present = errors.at_exposure(RigState(time_offset_s=-0.02), nav, TURNING)
    past = PastPoses.none().followed_by(nav, TURNING).at_exposure(-0.02)
    np.testing.assert_allclose(past.R[0], present.T_map_body.R, rtol=0, atol=1e-15)
    np.testing.assert_allclose(past.t[0], present.T_map_body.t, rtol=0, atol=1e-15)
    np.testing.assert_allclose(past.rate_map[0], TURNING.rate(-0.02), rtol=0, atol=1e-15)


def test_readings_after_the_stamp_are_missed_by_as_much_as_the_slope_changes() -> None:
    rng, later_s = np.random.default_rng(1), 0.02
    gusts, missed = Gusts(0.0, 0), []
    for before, after in rng.normal(0.0, 3.0, (2000, 2, 3)):
        gusts = gusts.added(Turning(RATE, before), Turning(RATE, after))
        missed.append(Turning(RATE, after).rotation(later_s) - Turning(RATE, before).rotation(later_s))
    claimed = gusts.rotation_variance(later_s)
    assert np.mean(np.square(missed)) < claimed < 5.0 * np.mean(np.square(missed))
    assert gusts.rotation_variance(-later_s) == 0.0  # before the stamp all is known


def test_an_exposure_after_the_stamp_is_judged_by_the_readings_after_it_once_they_are_there(course) -> None:
    """Of the newest past pose, whose stamp the increment begins at; before the stamp, by those before it."""
    rig = dataclasses.replace(EXACT_RIG, time_offset_sigma_s=0.01)
    first, second = course.increments[:2]
    second = dataclasses.replace(second, rate_slope_start=SLOPE)
    for offset_s in (0.01, -0.01):
        f = course.filter(rig_config=rig)
        f.predict(first)
        f.keep_pose()
        f.expect_time_offset(offset_s)
        known = f.past.rate_slope_map[-1].copy()
        f.predict(second)
        expected = f.past.R[-1] @ SLOPE if offset_s > 0.0 else known
        np.testing.assert_allclose(f.past.rate_slope_map[-1], expected, rtol=0, atol=1e-9)
