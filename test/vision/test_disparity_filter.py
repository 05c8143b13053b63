# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest

from uav_vslam.vision.disparity_filter import supported_disparities


def spread(count, seed=0):
    return np.random.default_rng(seed).uniform([0, 0], [1280, 960], (count, 2))


def test_wrong_disparities_above_flat_ground_are_removed():
    rng = np.random.default_rng(1)
    pixels = spread(300)
    disparity = 18.0 + 0.002 * pixels[:, 0] + rng.normal(0, 0.25, 300)
    wrong = rng.random(300) < 0.1
    disparity[wrong] += rng.choice([-1, 1], wrong.sum()) * rng.uniform(5, 40, wrong.sum())
    kept = supported_disparities(pixels, disparity, noise_px=1.0)
    assert kept[~wrong].mean() > 0.99
    assert kept[wrong].mean() < 0.2


def test_both_sides_of_a_depth_edge_survive():
    pixels = spread(300)
    disparity = np.where(pixels[:, 0] < 640, 10.0, 60.0)
    assert supported_disparities(pixels, disparity, noise_px=1.0).mean() > 0.99


def test_a_sparsely_sampled_steep_floor_survives():
    pixels = spread(40)
    assert supported_disparities(pixels, 0.1 * pixels[:, 1], noise_px=1.0).mean() > 0.95


@pytest.mark.parametrize("count", [0, 1, 2])
def test_too_few_points_to_vote_are_kept(count):
    assert supported_disparities(spread(count), np.arange(count) * 50.0, noise_px=1.0).tolist() == [True] * count


def test_identical_pixels_do_not_divide_by_zero():
    kept = supported_disparities(np.full((20, 2), 5.0), np.full(20, 3.0), noise_px=1.0)
    assert kept.all()
