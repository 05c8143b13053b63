# SPDX-License-Identifier: Apache-2.0
"""Patches are found where an affine warp of the image has taken them, over a texture whose true motion is known."""

from collections.abc import Callable

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from uav_vslam.vision.tracking.affine import HALF_PX, MOST_SCALED, Patches, fits, undeformed

Array = NDArray[np.float64]
Floats = NDArray[np.float32]

CENTRE = np.array([250.0, 200.0])
SETTLED_PX = 0.1
SHAPES = {
    "turned by 15 degrees": [[0.966, -0.259], [0.259, 0.966]],
    "closer by a quarter": [[1.25, 0.0], [0.0, 1.25]],
    "along a surface": [[1.0, 0.15], [0.0, 0.8]],
}


@pytest.fixture(scope="module")
def image(texture_image: Callable[[int, int], NDArray[np.uint8]]) -> Floats:
    return texture_image(400, 500).astype(np.float32)


@pytest.fixture(scope="module")
def pixels() -> Array:
    return np.random.default_rng(4).uniform(CENTRE - 90.0, CENTRE + 90.0, (60, 2))


def warped(image: Floats, A: Array, *, gain: float = 1.0, noise: float = 0.0) -> Floats:
    """Return the image moved by A about the centre."""
    M = np.column_stack([A, CENTRE - A @ CENTRE])
    moved = cv2.warpAffine(image, M, image.shape[::-1], flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT_101)
    return np.asarray(gain * moved + np.random.default_rng(5).normal(0.0, noise, moved.shape), np.float32)


@pytest.mark.parametrize("shape", SHAPES.values(), ids=SHAPES)
def test_a_deformed_patch_is_found_with_its_shape(image: Floats, pixels: Array, shape: list[list[float]]) -> None:
    A = np.array(shape)
    true = (pixels - CENTRE) @ A.T + CENTRE
    start = np.random.default_rng(6).normal(true, 0.3)
    near = np.tile((0.7 * A + 0.3 * np.eye(2)).astype(np.float32), (len(pixels), 1, 1))  # as a frame earlier
    found, shapes, good = Patches.cut(image, pixels).found(
        warped(image, A, gain=0.7, noise=1.0), start, near, settled_px=SETTLED_PX
    )
    assert good.mean() > 0.95
    assert np.median(np.linalg.norm(found - true, axis=1)[good]) < 0.05
    np.testing.assert_allclose(np.median(shapes[good], axis=0), A, atol=0.01)


def test_other_ground_and_too_large_a_change_of_scale_are_not_found(image: Floats, pixels: Array) -> None:
    patches = Patches.cut(image, pixels)
    _, _, good = patches.found(
        np.ascontiguousarray(image[::-1, ::-1]), pixels, undeformed(len(pixels)), settled_px=SETTLED_PX
    )
    assert good.mean() < 0.05
    for scale, least, most in ((0.9 * MOST_SCALED, 0.9, 1.0), (1.1 * MOST_SCALED, 0.0, 0.1)):
        A = np.diag([scale, 1.0 / np.sqrt(scale)])
        inner = pixels[np.abs((pixels - CENTRE) @ A).max(axis=1) < 180.0]
        near = np.tile((0.97 * A + 0.03 * np.eye(2)).astype(np.float32), (len(inner), 1, 1))
        true = (inner - CENTRE) @ A + CENTRE
        _, _, good = Patches.cut(image, inner).found(warped(image, A), true, near, settled_px=SETTLED_PX)
        assert least <= good.mean() <= most


def test_a_patch_must_be_inside_the_image(image: Floats) -> None:
    corners = np.array([[HALF_PX, HALF_PX], [499.0 - HALF_PX, 399.0 - HALF_PX]])
    assert fits(image, corners).all()
    assert not fits(image, corners + np.array([[-1.0, 0.0], [0.0, 1.0]])).any()


def test_flat_ground_is_not_found_and_breaks_nothing(image: Floats, pixels: Array) -> None:
    flat = np.full_like(image, 90.0)
    for first, second in ((flat, image), (image, flat), (flat, flat)):
        found, shapes, good = Patches.cut(first, pixels).found(
            second, pixels, undeformed(len(pixels)), settled_px=SETTLED_PX
        )
        assert np.isfinite(found).all()
        assert np.isfinite(shapes).all()
        assert not good.any()


@pytest.mark.parametrize("pattern", ["edge", "stripes"])
@pytest.mark.parametrize("degrees", [0.0, 30.0, 45.0, 60.0])
def test_along_an_edge_a_patch_stays_put_and_across_it_is_found(pattern: str, degrees: float) -> None:
    across = np.array([np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))])
    along = np.array([-across[1], across[0]])
    v, u = np.mgrid[:200, :200] - 100.0
    distance = u * across[0] + v * across[1]
    wave = np.sin(distance / 4.0) if pattern == "stripes" else np.tanh(distance / 2.0)
    image = (120.0 + 60.0 * wave).astype(np.float32)
    pixels = np.full((5, 2), 100.0) + np.arange(5)[:, None] * 0.7 * along
    start = pixels + np.array([0.3, 0.1])
    found, _, good = Patches.cut(image, pixels).found(image, start, undeformed(5), settled_px=SETTLED_PX)
    assert good.all()
    np.testing.assert_allclose((found - pixels) @ across, 0.0, atol=0.04)
    np.testing.assert_allclose((found - start) @ along, 0.0, atol=0.15)


def test_no_patch_is_no_trouble(image: Floats) -> None:
    none = Patches.cut(image, np.zeros((0, 2)))
    found, shapes, good = none.found(image, np.zeros((0, 2)), undeformed(0), settled_px=SETTLED_PX)
    assert len(none) == len(found) == len(shapes) == len(good) == 0
