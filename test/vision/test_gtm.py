# SPDX-License-Identifier: Apache-2.0
"""Graph transformation matching keeps matches with the same neighbours in both images."""

import numpy as np
import pytest

from uav_vslam.vision.matching.gtm import NEIGHBOURS, same_neighbours


def warped(points):
    """Apply a smooth deformation to pixels: rotation, scale and bending."""
    turn = 1.2 * np.array([[np.cos(0.4), -np.sin(0.4)], [np.sin(0.4), np.cos(0.4)]])
    return points @ turn.T + 4.0 * np.sin(points[:, ::-1] / 150.0)


@pytest.fixture
def points():
    return np.random.default_rng(1).uniform(0, 1000, (200, 2))


def test_a_similarity_loses_nothing(points):
    turn = np.array([[0.0, -1.7], [1.7, 0.0]])
    np.testing.assert_array_equal(same_neighbours(points, points @ turn.T + 30.0), np.arange(200))


@pytest.mark.parametrize("share", [0.1, 0.3, 0.6])
def test_wrong_matches_are_removed_under_a_smooth_deformation(points, share):
    rng = np.random.default_rng(2)
    there = warped(points)
    wrong = rng.choice(200, round(share * 200), replace=False)
    there[wrong] = rng.uniform(0, 1000, (len(wrong), 2))
    kept = same_neighbours(points, there)
    assert len(np.intersect1d(kept, wrong)) == 0
    assert len(kept) > 0.7 * (200 - len(wrong))


def test_remaining_matches_have_the_same_neighbours_by_brute_force(points):
    there = warped(points)
    there[::4] = np.random.default_rng(3).uniform(0, 1000, (50, 2))
    kept = same_neighbours(points, there)
    assert 50 < len(kept) < 200
    ends = []
    for side in (points, there):
        distance = np.linalg.norm(side[:, None] - side, axis=2)
        reach = np.median(distance[np.triu_indices(200, 1)])
        among = distance[np.ix_(kept, kept)] + np.diag(np.full(len(kept), np.inf))
        nearest = np.argsort(among, axis=1)[:, :NEIGHBOURS]
        ends.append([{k for k in row if among[i, k] <= reach} for i, row in enumerate(nearest)])
    assert ends[0] == ends[1]


def test_many_removals_trigger_new_neighbour_queries(points):
    there = np.random.default_rng(4).uniform(0, 1000, (200, 2))
    there[:15] = points[:15] * 0.01 + 500.0  # a few correct ones, close together among wrong ones
    kept = same_neighbours(points, there)
    assert len(kept) < 30
    assert len(np.intersect1d(kept, np.arange(15, 200))) <= 10


def test_a_single_match_is_dropped():
    assert len(same_neighbours(np.zeros((1, 2)), np.zeros((1, 2)))) == 0
    assert len(same_neighbours(np.zeros((0, 2)), np.zeros((0, 2)))) == 0
    assert same_neighbours(np.eye(2), np.eye(2)).tolist() == [0, 1]


def test_the_sides_may_have_different_dimensions(points):
    ground = np.column_stack([points, np.zeros(200)])
    np.testing.assert_array_equal(same_neighbours(points, ground), np.arange(200))
