# SPDX-License-Identifier: Apache-2.0
"""RANSAC keeps the inliers of one two-view geometry, and none if there is no such geometry."""

import numpy as np
import pytest

from uav_vslam.vision.features import Keypoints
from uav_vslam.vision.matching.ransac import ransac_fundamental, ransac_homography


def keypoints(pixels, descriptors):
    return Keypoints(pixels.astype(np.float32), np.ones(len(pixels), np.float32), descriptors)


def projected(points, shift):
    points = points + shift
    return 500.0 * points[:, :2] / points[:, 2:] + 300.0


@pytest.fixture
def scene():
    """Return descriptors and two views of a plane and of points in space; a third of the matches is wrong."""
    rng = np.random.default_rng(1)
    descriptors = rng.integers(0, 256, (150, 128)).astype(np.uint8)
    space = rng.uniform([-5, -5, 8], [5, 5, 16], (150, 3))
    plane = np.column_stack([space[:, :2], 10.0 + 0.3 * space[:, 0]])
    wrong = rng.uniform(0, 600, (50, 2))
    views = {}
    for name, points in (("plane", plane), ("space", space)):
        there = projected(points, np.array([1.0, 0.3, 0.2]))
        there[:50] = wrong
        views[name] = keypoints(projected(points, np.zeros(3)), descriptors), keypoints(there, descriptors)
    return views


def test_a_plane_is_one_homography(scene):
    pairs = ransac_homography(*scene["plane"], 0.8)
    np.testing.assert_array_equal(pairs[:, 0], pairs[:, 1])
    assert set(range(50, 150)) <= set(pairs[:, 0].tolist())
    assert len(pairs) <= 102  # wrong ones may fit by chance


def test_points_in_space_share_an_epipolar_geometry_but_no_homography(scene):
    pairs = ransac_fundamental(*scene["space"], 0.8)
    assert set(range(50, 150)) <= set(pairs[:, 0].tolist())
    assert len(pairs) < 110
    assert len(ransac_homography(*scene["space"], 0.8)) < 75


@pytest.mark.parametrize("matcher", [ransac_homography, ransac_fundamental])
def test_a_minimal_sample_gives_no_matches(matcher, scene):
    a, b = scene["plane"]
    few = slice(50, 54 if matcher is ransac_homography else 57)
    a, b = (keypoints(side.pixels[few], side.descriptors[few]) for side in (a, b))
    assert len(matcher(a, b, 0.8)) == 0
