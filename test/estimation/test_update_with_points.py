# SPDX-License-Identifier: Apache-2.0
"""An update by landmarks and by points with two views, where the prediction is far off."""

import copy
import dataclasses

import numpy as np
import pytest

from uav_vslam.estimation.tracks import Tracks
from uav_vslam.geometry.pose import Pose

KNOWN, NEW = np.arange(6), np.arange(6, 12)  # landmarks, and points that are none yet
SHIFT = np.array([12.0, -9.0, 3.0])  # [m] by which both poses of the points are predicted wrongly
SIGMA = 15.0  # [m]


@pytest.mark.parametrize("name", ["eif", "ekf", "ukf", "uhf"])
def test_both_poses_of_the_points_are_linearised_where_the_landmarks_lead(course, name: str) -> None:
    """The earlier pose is as wrong as the present one: left there, it is 15 m from it instead of 3 m."""
    rng = np.random.default_rng(3)
    f = course.filter("ri15", name, sigma_px=1.0)
    f.add_landmarks(course.pixels(0, KNOWN, rng))
    P = f.covariance()
    P[:3, :3] += SIGMA**2 * np.eye(3)
    course.set_covariance(f, P)
    T = f.nav.T_map_body
    f.mean = dataclasses.replace(f.mean, nav=dataclasses.replace(f.nav, T_map_body=Pose(T.R, T.t + SHIFT)))
    f.keep_pose()
    f.predict(course.increments[0])
    f.keep_pose()
    pixels = [course.pixels(frame, NEW, rng) for frame in range(2)]
    points = Tracks(np.stack(pixels, axis=1), np.ones((len(NEW), 2), bool), detected=True)
    tried, seen = copy.copy(f), course.pixels(1, KNOWN, rng)
    tried.update(KNOWN, seen)
    passed = f.update_with_points(points, KNOWN, seen, at=tried.mean, weights=np.ones(6), probability=0.999)
    assert passed.all()
    error = f.nav.T_map_body.t - course.true_state(1).T_map_body.t
    sigma = np.sqrt(np.diagonal(f.covariance())[:3])
    assert np.abs(error / sigma).max() < 3.0
    assert sigma.max() < 1.0
