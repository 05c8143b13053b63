# SPDX-License-Identifier: Apache-2.0
"""Past poses of the vehicle in the state."""

import dataclasses

import numpy as np
import pytest

from uav_vslam.config import EXACT_RIG
from uav_vslam.estimation.filter import Filter
from uav_vslam.estimation.filters import FILTERS
from uav_vslam.estimation.mean import Chart, Mean
from uav_vslam.estimation.models import MODELS, POSE
from uav_vslam.estimation.past_poses import COPY_VARIANCE
from uav_vslam.estimation.rig_errors import RigErrors
from uav_vslam.geometry.pose import POSE_DIM, Pose
from uav_vslam.geometry.rotation import so3_exp
from uav_vslam.ins.propagation import NAV_DIM
from uav_vslam.types import NavEstimate

FAR_AWAY = Pose(so3_exp(np.array([0.2, -0.1, 0.3])), np.array([5.0, -3.0, 60.0]))


def moved_to(pose: Pose, f: Filter) -> Mean:
    """Return the filter's mean, moved by the error towards another pose."""
    chart = Chart(MODELS["ri15"](), RigErrors(f.rig, EXACT_RIG, NAV_DIM))
    return chart.retract(f.mean, chart.local(f.mean, f.mean.at(pose)))


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
    f.predict(course.increments[2])
    moved = moved_to(FAR_AWAY, f)
    np.testing.assert_allclose(moved.nav.T_map_body.t, FAR_AWAY.t, atol=1e-9)
    np.testing.assert_allclose(moved.nav.T_map_body.R, FAR_AWAY.R, atol=1e-12)
    np.testing.assert_allclose(moved.nav.v_map, f.nav.v_map, atol=1e-9)
    np.testing.assert_allclose(moved.points, f.mean.points, atol=1e-9)
    np.testing.assert_allclose(moved.past.R, f.past.R, atol=1e-12)


def test_the_kept_pose_of_the_present_stays_that_of_the_present(course) -> None:
    f = course.flown(frames=2)
    f.keep_pose()
    f.predict(course.increments[2])
    f.keep_pose()
    for mean in (moved_to(FAR_AWAY, f), f.mean.at(FAR_AWAY)):
        np.testing.assert_allclose(mean.past.t, [f.past.t[0], FAR_AWAY.t], atol=1e-9)
        np.testing.assert_allclose(mean.past.R, [f.past.R[0], FAR_AWAY.R], atol=1e-12)


@pytest.mark.parametrize("name", ["eif", "ekf", "ukf"])
def test_after_an_update_linearised_far_away_too(course, name: str) -> None:
    """The velocity was 12 m/s off: the pose at the newest frame is 2 m from the predicted one."""
    state, P = course.initial.state, course.initial.covariance.copy()
    P[3:6, 3:6], P[6:9, 6:9] = 50.0 * np.eye(3), 0.01 * np.eye(3)
    wrong = dataclasses.replace(state, v_map=state.v_map + np.array([10.0, -6.0, 4.0]))
    f = FILTERS[name](NavEstimate(wrong, P), rig=course.rig, imu=course.imu)
    rows = np.arange(len(course.landmarks))
    f.add_landmarks(course.pixels(0, rows))
    f.predict(course.increments[0])
    f.keep_pose()
    before, truth = f.nav.T_map_body.t, course.true_state(1).T_map_body
    assert f.update(rows, course.pixels(1, rows), linearise_at=truth).accepted
    assert np.linalg.norm(f.nav.T_map_body.t - before) > 1.0
    np.testing.assert_allclose(f.past.t[-1], f.nav.T_map_body.t, atol=1e-6)
    np.testing.assert_allclose(f.past.R[-1], f.nav.T_map_body.R, atol=1e-8)
    np.testing.assert_allclose(f.past.v_map[-1], f.nav.v_map, atol=1e-9)
    apart = np.zeros((6, f.belief.size))
    apart[:, POSE], apart[:, f.vehicle - POSE_DIM : f.vehicle] = np.eye(6), -np.eye(6)
    np.testing.assert_allclose(apart @ f.covariance() @ apart.T, np.diag(COPY_VARIANCE), atol=1e-9)
