# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest

from uav_vslam.vision.selection import spread_selection

SIZE = (1000, 800)


def test_a_weak_lonely_point_is_preferred_to_a_strong_crowd():
    crowd = np.random.default_rng(0).uniform([0, 0], [50, 50], (100, 2))
    pixels = np.vstack([crowd, [[900.0, 700.0]]])
    strength = np.append(np.full(100, 9.0), 0.1)
    assert 100 in spread_selection(pixels, strength, size=SIZE, count=10)


def test_within_a_cell_the_strongest_are_taken():
    pixels = np.full((20, 2), 10.0)
    strength = np.random.default_rng(1).permutation(20).astype(float)
    chosen = spread_selection(pixels, strength, size=SIZE, count=5)
    assert sorted(strength[chosen]) == [15, 16, 17, 18, 19]


def test_points_just_outside_the_image_have_cells_of_their_own():
    pixels = np.array([[-5.0, 10.0], [5.0, 10.0], [6.0, 10.0]])
    chosen = spread_selection(pixels, [1.0, 3.0, 2.0], size=SIZE, count=2)
    assert chosen.tolist() == [0, 1]


@pytest.mark.parametrize("count", [0, 3, 7])
def test_fewer_points_than_wanted_are_all_kept_in_order(count):
    pixels = np.random.default_rng(2).uniform(0, 800, (count, 2))
    assert spread_selection(pixels, np.ones(count), size=SIZE, count=7).tolist() == list(range(count))


def test_indices_are_unique_and_ascending():
    pixels = np.random.default_rng(3).uniform([0, 0], SIZE, (500, 2))
    chosen = spread_selection(pixels, np.ones(500), size=SIZE, count=120)
    assert len(chosen) == 120
    assert (np.diff(chosen) > 0).all()
