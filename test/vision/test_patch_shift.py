# SPDX-License-Identifier: Apache-2.0
from functools import cache

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from uav_vslam.vision.patch_shift import patch_shift

Real = NDArray[np.float32]

SIZE, FINER = 96, 20


@cache
def clouds(seed: int) -> NDArray[np.float64]:
    """Return the finer picture; its blur takes two seconds."""
    fine = cv2.GaussianBlur(np.random.default_rng(seed).normal(0.0, 1.0, (2600, 2600)), (0, 0), 1.5 * FINER)
    return np.asarray(120.0 + 25.0 * fine / fine.std())


def patch(shift: tuple[float, float], seed: int = 1) -> Real:
    """Return a cloudy patch moved by whole steps of a finer picture, averaged down, with noise."""
    fine = clouds(seed)
    u, v = (300 - round(FINER * step) for step in shift)
    cut = fine[v : v + SIZE * FINER, u : u + SIZE * FINER].astype(np.float32)
    drawn = cv2.resize(cut, (SIZE, SIZE), interpolation=cv2.INTER_AREA)
    return np.asarray(
        drawn + np.random.default_rng(abs(round(1000 * shift[0])) + 7).normal(0.0, 1.0, drawn.shape), np.float32
    )


@pytest.mark.parametrize("shift", [(0.0, 0.0), (0.25, -0.25), (0.3, 0.1), (-0.5, 0.5), (3.7, -6.35)])
def test_fractions_of_a_pixel_are_found(shift: tuple[float, float]) -> None:
    found = patch_shift(patch((0.0, 0.0)), patch(shift))
    assert found is not None
    np.testing.assert_allclose(found, shift, atol=0.05)


def test_patches_are_left_as_they_are() -> None:
    first, second = patch((0.0, 0.0)), patch((1.0, 0.0))
    before = first.copy(), second.copy()
    patch_shift(first, second)
    np.testing.assert_array_equal(first, before[0])
    np.testing.assert_array_equal(second, before[1])


@pytest.mark.slow
def test_patches_of_different_places_have_no_shift() -> None:
    assert patch_shift(patch((0.0, 0.0)), patch((0.0, 0.0), seed=2)) is None
