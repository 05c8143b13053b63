# SPDX-License-Identifier: Apache-2.0
"""The nearest points of an image are those of SciPy's tree."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from uav_vslam.vision.nearest_points import nearest_points

ROUNDING_PX = 1e-9


@pytest.mark.parametrize(("number", "count"), [(1, 1), (3, 3), (14, 13), (400, 13), (2000, 1)])
def test_they_are_those_of_an_exact_search(number: int, count: int) -> None:
    rng = np.random.default_rng(number)
    points, queries = rng.uniform(0.0, 1000.0, (number, 2)), rng.uniform(-50.0, 1050.0, (300, 2))
    distance, rows = nearest_points(queries, points, count)
    expected_distance, expected_rows = cKDTree(points).query(queries, k=range(1, count + 1))
    assert np.array_equal(rows, expected_rows)
    np.testing.assert_allclose(distance, expected_distance, rtol=0, atol=ROUNDING_PX)


def test_points_at_one_place_are_all_found() -> None:
    points = np.repeat([[3.0, 4.0], [100.0, 0.0]], [3, 20], axis=0)
    distance, rows = nearest_points(np.zeros((1, 2), np.float32), points, 4)
    assert distance.tolist() == [[5.0, 5.0, 5.0, 100.0]]
    assert set(rows[0, :3]) == {0, 1, 2}


def test_no_query_has_no_neighbours() -> None:
    distance, rows = nearest_points(np.zeros((0, 2)), np.ones((5, 2)), 2)
    assert distance.shape == rows.shape == (0, 2)
