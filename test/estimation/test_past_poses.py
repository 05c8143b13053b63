# SPDX-License-Identifier: Apache-2.0
"""Past poses of the vehicle in the state."""

import numpy as np

from uav_vslam.geometry.pose import POSE_DIM, Pose
from uav_vslam.geometry.rotation import so3_exp


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
