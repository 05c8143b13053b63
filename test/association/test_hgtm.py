# SPDX-License-Identifier: Apache-2.0
"""Hypergraph transformation keeps the matches whose shapes are the same in image and map."""

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


def test_a_prediction_at_twice_the_height_or_more_is_another_place(points):
    assert len(same_shapes(2.2 * points, points)) == 0


@pytest.mark.parametrize("share", [0.1, 0.3, 0.5])
def test_strangers_go_and_the_others_stay(points, share):
    rng = np.random.default_rng(2)
    wrong = rng.choice(100, round(100 * share), replace=False)
    expected = turned(points) + rng.normal(0, 0.5, points.shape)
    expected[wrong] = rng.uniform(0, 1000, (len(wrong), 2))
    kept = same_shapes(expected, points)
    assert len(np.intersect1d(kept, wrong)) <= 1
    assert len(kept) > 0.9 * (100 - len(wrong))


def test_a_match_off_by_a_little_is_noticed_where_neighbourhoods_do_not_change(points):
    """Thirty pixels: a third of the distance between neighbours."""
    expected = points.copy()
    expected[:5] += [30.0, 0.0]
    assert len(np.intersect1d(same_shapes(expected, points), np.arange(5))) == 0
    assert len(np.intersect1d(same_neighbours(expected, points), np.arange(5))) > 0


def test_hyperedges_are_each_point_with_two_of_its_nearest():
    line = np.column_stack([[0.0, 1.0, 3.0, 7.0], np.zeros(4)])
    assert hyperedges(line, 2).tolist() == [[0, 1, 2], [1, 2, 3]]
    assert hyperedges(line[:2], 2).shape == (0, 3)
    together = np.zeros((4, 2))  # who is whose nearest is arbitrary, but nobody is his own neighbour
    assert (np.diff(hyperedges(together, 2), axis=1) > 0).all()


def test_two_matches_form_no_shape(points):
    assert len(same_shapes(points[:2], points[:2])) == 0
    assert same_shapes(points[:3], points[:3]).tolist() == [0, 1, 2]
