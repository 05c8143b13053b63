# SPDX-License-Identifier: Apache-2.0
"""Landmarks whose distance is hardly known are marginalised; the others keep their joint belief."""

import numpy as np
import pytest

from uav_vslam.cooperation.own_landmarks import LOOSE, well_ranged
from uav_vslam.geometry.pose import POSE_DIM, Pose

DRIFT_M = 30.0  # of the vehicle since it saw the landmarks, far more than any distance's error
POSE = Pose(np.eye(3), np.zeros(3))
BELOW = np.array([[5.0, 0.0, -80.0], [-9.0, 4.0, -80.0], [0.0, 7.0, -60.0]])


@pytest.fixture
def belief(make_joint):
    """Return a maker of beliefs over the vehicle and points below it, with a sigma of each one's height [m]."""

    def make(*sigmas_m: float):
        shared = DRIFT_M * np.vstack([np.zeros((POSE_DIM, 3)), np.tile(np.eye(3), (len(BELOW), 1))])
        own = np.r_[np.full(POSE_DIM, 1e-4), np.ravel([[1e-4, 1e-4, sigma**2] for sigma in sigmas_m])]
        return make_joint(BELOW, shared @ shared.T + np.diag(own), T_map_body=POSE)

    return make


def test_landmarks_with_a_loose_distance_are_left_out(belief):
    """The sigma counts in proportion to the distance from the vehicle, however far that has drifted since."""
    joint = belief(1.0, 1.3 * LOOSE * 80.0, 0.9 * LOOSE * 60.0)

    kept = well_ranged(joint)

    np.testing.assert_array_equal(kept.ids, joint.ids[[0, 2]])
    np.testing.assert_array_equal(kept.positions, joint.positions[[0, 2]])
    np.testing.assert_array_equal(kept.descriptors, joint.descriptors[[0, 2]])
    rows = np.r_[0 : POSE_DIM + 3, POSE_DIM + 6 : POSE_DIM + 9]
    np.testing.assert_allclose(kept.covariance, joint.covariance[np.ix_(rows, rows)], rtol=1e-6, atol=1e-9)


def test_well_known_distances_leave_the_belief_as_it_is(belief):
    joint = belief(1.0, 2.0, 3.0)

    assert well_ranged(joint) is joint


def test_nothing_but_loose_landmarks_leave_the_pose(belief):
    joint = belief(20.0, 20.0, 20.0)

    alone = well_ranged(joint)

    assert len(alone.ids) == 0
    np.testing.assert_allclose(alone.covariance, joint.covariance[:POSE_DIM, :POSE_DIM], rtol=1e-6)
