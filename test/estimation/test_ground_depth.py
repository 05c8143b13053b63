# SPDX-License-Identifier: Apache-2.0
"""The depth of the ground that points show: of level and of steep views, and where there is none."""

import numpy as np
import pytest
from numpy.typing import NDArray

from uav_vslam.estimation.ground_depth import ENOUGH, ground_depth

Array = NDArray[np.float64]

ALTITUDE_M, RELIEF = 70.0, 0.043
DISPARITY_SIGMA = 1.0 / 18.0  # of the inverse depth, over that of the altitude: 1 px


def rays(count: int, rng: np.random.Generator) -> Array:
    """Draw (N, 3) rays, of unit depth, of a camera that sees 44 by 33 degrees."""
    return np.column_stack([rng.uniform(-0.4, 0.4, count), rng.uniform(-0.3, 0.3, count), np.ones(count)])


def ground(tilt_deg: float, seen: Array) -> Array:
    """Return the depths (N,) of level ground along the rays of a camera that is tilted away from straight down [m]."""
    tilt = np.deg2rad(tilt_deg)
    return ALTITUDE_M / (np.cos(tilt) * seen[:, 2] - np.sin(tilt) * seen[:, 1])


def noisy(depth: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    """Return depths (N,) [m] by a noisy disparity, and their variances [m^2]."""
    found = 1.0 / (1.0 / depth + rng.normal(0.0, DISPARITY_SIGMA / ALTITUDE_M, len(depth)))
    return found, (DISPARITY_SIGMA / ALTITUDE_M * found**2) ** 2


@pytest.mark.parametrize("tilt_deg", [45.0, 60.0])
def test_in_a_steep_view_it_is_that_of_a_plane(tilt_deg: float) -> None:
    rng = np.random.default_rng(1)
    seen = rays(200, rng)
    true = ground(tilt_deg, seen)
    depth, variance = noisy(true, rng)
    found = ground_depth(seen * depth[:, None], variance, RELIEF)
    assert found is not None
    assert np.abs(found / true - 1.0).max() < 0.15
    assert np.abs(np.median(depth) / true - 1.0).max() > 0.25


@pytest.mark.parametrize("tilt_deg", [0.0, 25.0])
def test_from_above_and_in_a_bank_it_is_the_median(tilt_deg: float) -> None:
    for seed in range(50):
        rng = np.random.default_rng(seed)
        seen = rays(40, rng)
        depth, variance = noisy(ground(tilt_deg, seen), rng)
        np.testing.assert_array_equal(ground_depth(seen * depth[:, None], variance, RELIEF), np.median(depth))


def test_few_points_tell_no_slope() -> None:
    rng = np.random.default_rng(1)
    seen = rays(ENOUGH - 1, rng)
    depth, variance = noisy(ground(60.0, seen), rng)
    np.testing.assert_array_equal(ground_depth(seen * depth[:, None], variance, RELIEF), np.median(depth))


def test_a_room_shows_no_ground() -> None:
    """Walls of a room of 9 by 9 m, seen from its middle, and things before them."""
    for seed in range(20):
        rng = np.random.default_rng(seed)
        depth = rng.choice([1.5, 3.0, 4.5], 60) * rng.uniform(0.9, 1.1, 60)
        assert ground_depth(rays(60, rng) * depth[:, None], (0.02 * depth) ** 2, RELIEF) is None
