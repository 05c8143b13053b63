# SPDX-License-Identifier: Apache-2.0
"""Hypergraph transformation matching keeps the matches with equal shapes in image and map."""

import numpy as np
import pytest

from uav_vslam.association.hgtm import hyperedges, same_shapes
from uav_vslam.vision.matching.gtm import same_neighbours


@pytest.fixture
def points():
    return np.random.default_rng(1).uniform(0, 1000, (100, 2))


def turned(points, angle=0.3, scale=1.1):
    c, s = scale * np.cos(angle), scale * np.sin(angle)
    return points @ np.array([[c, s], [-s, c]]) + [50.0, -20.0]


def test_rotation_scale_and_shift_of_the_prediction_do_not_matter(points):
    np.testing.assert_array_equal(same_shapes(turned(points), points), np.arange(100))


def test_an_implausible_scale_is_rejected(points):
    assert len(same_shapes(2.2 * points, points)) == 0


@pytest.mark.parametrize("share", [0.1, 0.3, 0.5])
def test_wrong_matches_are_removed_and_correct_ones_kept(points, share):
    rng = np.random.default_rng(2)
    wrong = rng.choice(100, round(100 * share), replace=False)
    expected = turned(points) + rng.normal(0, 0.5, points.shape)
    expected[wrong] = rng.uniform(0, 1000, (len(wrong), 2))
    kept = same_shapes(expected, points)
    assert len(np.intersect1d(kept, wrong)) <= 1
    assert len(kept) > 0.9 * (100 - len(wrong))


def test_a_slightly_wrong_match_is_detected_although_neighbourhoods_are_unchanged(points):
    """Thirty pixels: a third of the distance between neighbours."""
    expected = points.copy()
    expected[:5] += [30.0, 0.0]
    assert len(np.intersect1d(same_shapes(expected, points), np.arange(5))) == 0
    assert len(np.intersect1d(same_neighbours(expected, points), np.arange(5))) > 0


def test_hyperedges_are_each_point_with_two_of_its_nearest():
    line = np.column_stack([[0.0, 1.0, 3.0, 7.0], np.zeros(4)])
    assert hyperedges(line, 2).tolist() == [[0, 1, 2], [1, 2, 3]]
    assert hyperedges(line[:2], 2).shape == (0, 3)
    together = np.zeros((4, 2))  # neighbours are arbitrary here, but no point is its own
    assert (np.diff(hyperedges(together, 2), axis=1) > 0).all()


def test_two_matches_have_no_hyperedge(points):
    assert len(same_shapes(points[:2], points[:2])) == 0
    assert same_shapes(points[:3], points[:3]).tolist() == [0, 1, 2]
