# SPDX-License-Identifier: Apache-2.0
"""Coded points decode to the points and covariances that were encoded."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from uav_vslam.geometry.coded_points import (
    FACTOR_STEPS,
    SMALLEST_SIZE_M,
    AnchoredPoints,
    DensePoints,
    block_diagonal,
    diagonal_blocks,
    pack_lower,
    rigid_jacobian,
    similarity_jacobian,
    size_code,
    size_m,
    unpack_lower,
)
from uav_vslam.geometry.rotation import so3_exp

CODE_STEP = 2.0 ** (1 / 2048)


def lower(rng: np.random.Generator, *shape: int) -> np.ndarray:
    return np.tril(rng.normal(size=shape))


def test_dense_points_keep_the_full_covariance() -> None:
    rng = np.random.default_rng(0)
    L = lower(rng, 9, 9)
    points = DensePoints(rng.normal(size=(3, 3)).astype(np.float32), pack_lower(L).astype(np.float32))
    np.testing.assert_allclose(points.covariance, L @ L.T, rtol=0, atol=1e-5)  # single precision
    assert points.offsets_m.dtype == float


def test_anchored_points_keep_common_and_independent_errors() -> None:
    rng = np.random.default_rng(1)
    common, own = lower(rng, 7, 7), rng.integers(-127, 128, (4, 6)).astype(np.int8)
    sizes = np.array([0, 2048, 20480, 30000], np.uint16)
    offsets = rng.integers(-3000, 3000, (4, 3)).astype(np.int16)
    points = AnchoredPoints(offsets, pack_lower(common).astype(np.float32), own, sizes)
    np.testing.assert_allclose(points.offsets_m, offsets * 0.02, rtol=1e-15)
    J = similarity_jacobian(points.offsets_m)
    expected = J @ common @ common.T @ J.T
    for i, size in enumerate([1e-4, 2e-4, 1e-4 * 2**10, 1e-4 * 2 ** (30000 / 2048)]):
        L = np.zeros((3, 3))
        L[np.tril_indices(3)] = own[i] * size / FACTOR_STEPS
        expected[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] += L @ L.T
    np.testing.assert_allclose(points.covariance, expected, rtol=1e-5, atol=1e-5 * np.abs(expected).max())


@pytest.mark.parametrize("n", [0, 1, 5])
def test_any_number_of_points_has_a_covariance(n: int) -> None:
    dense = DensePoints(np.zeros((n, 3), np.float32), np.zeros(3 * n * (3 * n + 1) // 2, np.float32))
    anchored = AnchoredPoints(
        np.zeros((n, 3), np.int16), np.zeros(28, np.float32), np.zeros((n, 6), np.int8), np.zeros(n, np.uint16)
    )
    assert dense.covariance.shape == anchored.covariance.shape == (3 * n, 3 * n)
    assert dense.offsets_m.shape == anchored.offsets_m.shape == (n, 3)


def test_the_rigid_jacobian_is_the_numerical_one() -> None:
    points = np.random.default_rng(2).uniform(-50, 50, (5, 3))
    J, step = rigid_jacobian(points), 1e-6
    for k in range(6):
        twist = step * np.eye(6)[k]
        forth, back = (points @ so3_exp(s * twist[3:]).T + s * twist[:3] for s in (1.0, -1.0))
        np.testing.assert_allclose(J[:, k], (forth - back).ravel() / (2 * step), rtol=0, atol=1e-7)


def test_a_similarity_is_a_rigid_motion_and_a_scale() -> None:
    points = np.random.default_rng(3).uniform(-50, 50, (5, 3))
    J = similarity_jacobian(points)
    np.testing.assert_array_equal(J[:, :6], rigid_jacobian(points))
    np.testing.assert_array_equal((J @ [0, 0, 0, 0, 0, 0, 0.1]).reshape(-1, 3), 0.1 * points)


@given(st.floats(0.0, 4e5))
def test_a_size_is_rounded_up(size: float) -> None:
    coded = float(size_m(size_code(np.array([size])))[0])
    least = max(size, SMALLEST_SIZE_M)
    assert least * (1 - 1e-12) <= coded <= least * CODE_STEP * (1 + 1e-12)


def test_sizes_beyond_the_range_saturate() -> None:
    assert size_code(np.array([1e9])).tolist() == [65535]
    assert 4e5 < size_m(np.array([65535], np.uint16))[0] < 5e5


@pytest.mark.parametrize("shape", [(1, 1), (3, 3), (4, 3, 3), (0, 0), (0, 3, 3)])
def test_lower_triangles_are_packed_row_by_row(shape: tuple[int, ...]) -> None:
    L = lower(np.random.default_rng(3), *shape)
    np.testing.assert_array_equal(unpack_lower(pack_lower(L)), L)
    assert pack_lower(np.arange(9).reshape(3, 3)).tolist() == [0, 3, 4, 6, 7, 8]


def test_diagonal_blocks_round_trip() -> None:
    blocks = np.random.default_rng(4).normal(size=(2, 3, 3))
    A = block_diagonal(blocks)
    assert np.count_nonzero(A) == 18
    np.testing.assert_array_equal(diagonal_blocks(A), blocks)
    assert diagonal_blocks(np.zeros((0, 0))).shape == (0, 3, 3)
