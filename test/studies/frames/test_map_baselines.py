# SPDX-License-Identifier: Apache-2.0
"""An alignment's errors are those of the maps, not of the reference."""

import numpy as np
import pytest

from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.rotation import rotation_from_rpy
from uav_vslam.studies.engine.association_stages import Identities
from uav_vslam.studies.frames.map_baselines import alignment_error, common_rows, map_to_map, weighted_map_to_map


def test_the_reference_is_the_transform_between_equal_shapes(make_joint) -> None:
    rng = np.random.default_rng(0)
    points = rng.uniform(-30, 30, (6, 3))
    T = Pose(rotation_from_rpy(0.0, 0.0, -2.0), np.array([9.0, -40.0, 3.0]))
    own = make_joint(points[:5], np.eye(21))
    peer = make_joint(T.inverse().apply(points[[5, 3, 1, 0]]), np.eye(18), vehicle="uav2")
    truth = Identities({k + 1: k for k in range(5)}, {1: 5, 2: 3, 3: 1, 4: 0})
    found, centre = map_to_map(own, peer, truth)
    np.testing.assert_allclose(found.matrix, T.matrix, atol=1e-9)
    np.testing.assert_allclose(T.apply(centre), points[[3, 1, 0]].mean(axis=0))
    np.testing.assert_array_equal(common_rows(own, peer, truth), [[0, 3], [1, 2], [3, 1]])
    np.testing.assert_allclose(weighted_map_to_map(own, peer, truth, 0.3).matrix, T.matrix, atol=1e-4)


def test_errors_are_at_the_centre_and_in_degrees() -> None:
    centre = np.array([100.0, 0.0, 0.0])
    T = Pose(np.eye(3), np.array([1.0, 2.0, 3.0]))
    turned = Pose(rotation_from_rpy(0.0, 0.0, np.deg2rad(-2.0)), T.t)
    metres, degrees = alignment_error(turned, T, centre)
    assert metres == pytest.approx(200.0 * np.sin(np.deg2rad(1.0)))
    assert degrees == pytest.approx(2.0)
