# SPDX-License-Identifier: Apache-2.0
"""Cholesky-based algebra, and errors for matrices that are not positive definite."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from uav_vslam.errors import FilterDivergence
from uav_vslam.numerics import (
    cholesky,
    inverse_of_triangle,
    inverse_spd,
    mahalanobis2,
    marginalise_information,
    solve_spd,
    submatrix,
    symmetrise,
)

Array = NDArray[np.float64]

RELATIVE = 1e-9  # condition numbers here stay below 1e6


def random_spd(seed: int, n: int) -> Array:
    rng = np.random.default_rng(seed)
    Q, _ = np.linalg.qr(rng.normal(size=(n, n)))
    return symmetrise((Q * 10.0 ** rng.uniform(-2.0, 2.0, n)) @ Q.T)


SPD = st.builds(random_spd, st.integers(0, 2**32 - 1), st.integers(1, 12))


@given(SPD)
def test_inverse_and_solve_agree_with_the_definition(A: Array) -> None:
    inverse = inverse_spd(A, "A")
    np.testing.assert_array_equal(inverse, inverse.T)
    np.testing.assert_allclose(A @ inverse, np.eye(len(A)), rtol=0, atol=RELATIVE)
    b = np.arange(1.0, len(A) + 1.0)
    np.testing.assert_allclose(A @ solve_spd(A, b, "A"), b, rtol=RELATIVE, atol=RELATIVE)
    L = cholesky(A, "A")
    np.testing.assert_array_equal(L, np.tril(L))
    np.testing.assert_allclose(L @ L.T, A, rtol=RELATIVE, atol=RELATIVE)


@pytest.mark.parametrize("n", [0, 1, 80, 240])
def test_a_triangle_is_inverted_directly_or_by_halves(n: int) -> None:
    L = cholesky(random_spd(n, n), "A")
    before = L.copy()
    inverse = inverse_of_triangle(L)
    np.testing.assert_array_equal(inverse, np.tril(inverse))
    np.testing.assert_allclose(inverse @ L, np.eye(n), rtol=0, atol=RELATIVE)
    np.testing.assert_array_equal(L, before)


def test_the_inverse_of_an_empty_matrix_is_empty_and_lapack_says_nothing(capfd: pytest.CaptureFixture[str]) -> None:
    assert inverse_spd(np.zeros((0, 0)), "A").shape == (0, 0)
    assert capfd.readouterr() == ("", "")


def test_a_submatrix_has_the_rows_and_columns_in_the_order_asked_for() -> None:
    A, rows, columns = np.arange(30.0).reshape(5, 6), np.array([3, 0]), np.array([5, 1, 2])
    np.testing.assert_array_equal(submatrix(A, rows), A[np.ix_(rows, rows)])
    np.testing.assert_array_equal(submatrix(A, rows, columns), A[np.ix_(rows, columns)])
    assert not np.shares_memory(submatrix(A, np.arange(5), np.arange(6)), A)


@given(st.integers(0, 2**32 - 1), st.integers(2, 12), st.data())
def test_marginal_information_is_the_inverse_of_the_covariance_block(seed: int, n: int, data: st.DataObject) -> None:
    Y = random_spd(seed, n)
    order = np.array(data.draw(st.permutations(range(n))))
    kept = data.draw(st.integers(1, n))
    keep, drop = order[:kept], order[kept:]
    marginal = marginalise_information(Y, keep, drop, "Y")
    expected = np.linalg.inv(np.linalg.inv(Y)[np.ix_(keep, keep)])
    np.testing.assert_allclose(marginal, expected, rtol=1e-6, atol=1e-6 * np.abs(expected).max())


def test_a_lost_definiteness_names_the_matrix_the_eigenvalue_and_the_size() -> None:
    A = np.diag([4.0, -0.25, 1.0])
    for call in (
        lambda: cholesky(A, "information at 12.300 s"),
        lambda: inverse_spd(A, "information at 12.300 s"),
        lambda: solve_spd(A, np.ones(3), "information at 12.300 s"),
        lambda: marginalise_information(
            np.eye(4) - 1.25 * np.diag([0, 1.0, 0, 0]), [0], [1, 2, 3], "information at 12.300 s"
        ),
    ):
        with pytest.raises(
            FilterDivergence, match=r"information at 12\.300 s .* smallest eigenvalue -2\.500e-01 of 3 rows"
        ):
            call()


@pytest.mark.parametrize("value", [np.nan, np.inf])
@pytest.mark.parametrize("entry", [(0, 0), (3, 1), (3, 3)])
def test_a_matrix_that_is_not_finite_is_rejected(value: float, entry: tuple[int, int]) -> None:
    A = np.eye(4)
    A[entry] = A[entry[::-1]] = value
    for call in (cholesky, inverse_spd, lambda A, what: solve_spd(A, np.ones(4), what)):
        with pytest.raises(FilterDivergence, match=r"information .* smallest eigenvalue nan of 4 rows"):
            call(A, "information")


def test_marginalising_nothing_returns_a_copy() -> None:
    Y = random_spd(1, 3)
    out = marginalise_information(Y, np.arange(3), np.zeros(0, np.int64), "Y")
    np.testing.assert_array_equal(out, Y)
    assert not np.shares_memory(out, Y)


def test_symmetrise_works_on_stacks() -> None:
    A = np.random.default_rng(0).normal(size=(4, 3, 3))
    S = symmetrise(A)
    np.testing.assert_array_equal(S, np.swapaxes(S, 1, 2))
    np.testing.assert_allclose(S + 0.5 * (A - np.swapaxes(A, 1, 2)), A)


@pytest.mark.parametrize("shape", [(0,), (7,), (2, 3)])
def test_batched_mahalanobis_distances_equal_the_single_ones(shape: tuple[int, ...]) -> None:
    count = int(np.prod(shape))
    S = np.array([random_spd(k, 4) for k in range(count)]).reshape(*shape, 4, 4)
    r = np.random.default_rng(1).normal(size=(*shape, 4))
    expected = [x @ solve_spd(A, x, "S") for x, A in zip(r.reshape(-1, 4), S.reshape(-1, 4, 4), strict=True)]
    np.testing.assert_allclose(mahalanobis2(r, S), np.reshape(expected, shape), rtol=RELATIVE)
