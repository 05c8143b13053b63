# SPDX-License-Identifier: Apache-2.0
"""Past poses of the vehicle in the state."""

import dataclasses

import numpy as np

from uav_vslam.config import EXACT_RIG
from uav_vslam.estimation.mean import Chart
from uav_vslam.estimation.models import MODELS
from uav_vslam.estimation.rig_errors import RigErrors
from uav_vslam.geometry.pose import POSE_DIM, Pose
from uav_vslam.geometry.rotation import so3_exp
from uav_vslam.ins.propagation import NAV_DIM


def test_past_poses_are_moved_with_the_map(course) -> None:
    """A correction of the whole map by a rigid motion moves the past poses with it."""
    f = course.filter()
    f.keep_pose()
    f.predict(course.increments[0])
    shift, yaw = np.array([0.3, -0.2, 0.1]), 0.01
    turn = np.array([0.0, 0.0, yaw])
    delta = np.zeros(f.belief.size)
    nav, past = f.nav, f.past.pose(0)
    delta[:3], delta[6:9] = shift + np.cross(turn, nav.T_map_body.t), turn
    delta[3:6] = np.cross(turn, nav.v_map)
    start = f.vehicle - POSE_DIM
    delta[start : start + 3], delta[start + 3 :] = shift + np.cross(turn, past.t), turn
    f.correct(f.belief, delta)
    moved = Pose(so3_exp(turn), f.nav.T_map_body.t - so3_exp(turn) @ nav.T_map_body.t)
    np.testing.assert_allclose(f.past.t[0], moved.apply(past.t), atol=1e-9)
    np.testing.assert_allclose(f.past.R[0], moved.R @ past.R, atol=1e-12)


def test_the_error_towards_another_pose_moves_there_and_leaves_the_points_in_place(course) -> None:
    f = course.flown(frames=2)
    f.keep_pose()
    other = dataclasses.replace(
        f.nav, T_map_body=Pose(so3_exp(np.array([0.2, -0.1, 0.3])), np.array([5.0, -3.0, 60.0]))
    )
    chart = Chart(MODELS["ri15"](), RigErrors(course.rig, EXACT_RIG, NAV_DIM))
    moved = chart.retract(f.mean, chart.local(f.mean, dataclasses.replace(f.mean, nav=other)))
    np.testing.assert_allclose(moved.nav.T_map_body.t, other.T_map_body.t, atol=1e-9)
    np.testing.assert_allclose(moved.nav.T_map_body.R, other.T_map_body.R, atol=1e-12)
    np.testing.assert_allclose(moved.nav.v_map, f.nav.v_map, atol=1e-9)
    np.testing.assert_allclose(moved.points, f.mean.points, atol=1e-9)
    np.testing.assert_array_equal(moved.past.R, f.past.R)
