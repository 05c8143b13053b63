# SPDX-License-Identifier: Apache-2.0
"""The block recursions against dense linear algebra."""

import numpy as np
import pytest

from uav_vslam.errors import FilterDivergence
from uav_vslam.smoothing.arrowhead import Arrowhead, covariance_of, factorise, marginal_covariances

TOLERANCE = 1e-10  # rounding, at a condition number of some thousand


def filled(blocks: int, size: int, border: int, rng: np.random.Generator) -> tuple[Arrowhead, np.ndarray, np.ndarray]:
    """Return a random system and the same as dense H and g."""
    system = Arrowhead.zeros(blocks, size, border)
    chain, total = blocks * size, blocks * size + border
    H = np.zeros((total, total))
    for k in range(blocks):
        rows = np.r_[k * size : min(k + 2, blocks) * size, chain:total]
        J = rng.normal(size=(3 * len(rows), len(rows)))
        H[np.ix_(rows, rows)] += J.T @ J
    g = rng.normal(size=total)
    for k in range(blocks):
        here = slice(k * size, (k + 1) * size)
        system.diagonal[k], system.coupling[k], system.rhs[k] = H[here, here], H[here, chain:], g[here]
        if k + 1 < blocks:
            system.below[k] = H[(k + 1) * size : (k + 2) * size, here]
    system.border[:], system.border_rhs[:] = H[chain:, chain:], g[chain:]
    return system, H, g


@pytest.mark.parametrize(("blocks", "border"), [(1, 0), (1, 4), (2, 0), (5, 0), (5, 4)])
def test_solution_and_marginals_equal_those_of_the_dense_system(blocks: int, border: int) -> None:
    size, rng = 6, np.random.default_rng(blocks + 10 * border)
    system, H, g = filled(blocks, size, border, rng)
    factor = factorise(system)
    x, P = np.linalg.solve(H, g), np.linalg.inv(H)
    chain = blocks * size
    assert np.allclose(factor.solution.ravel(), x[:chain], rtol=0, atol=TOLERANCE * np.abs(x).max())
    assert np.allclose(factor.border_solution, x[chain:], rtol=0, atol=TOLERANCE * np.abs(x).max())
    assert np.allclose(factor.border_covariance, P[chain:, chain:], rtol=0, atol=TOLERANCE * P.max())
    for k, marginal in enumerate(marginal_covariances(factor).blocks):
        here = slice(k * size, (k + 1) * size)
        assert np.allclose(marginal, P[here, here], rtol=0, atol=TOLERANCE * P.max())


@pytest.mark.parametrize(("first", "count"), [(0, 5), (1, 3), (4, 1)])
@pytest.mark.parametrize("border", [0, 4])
def test_covariance_of_functions_of_some_blocks_equals_the_dense_one(first: int, count: int, border: int) -> None:
    blocks, size, rows, rng = 5, 6, 7, np.random.default_rng(first + 10 * border)
    system, H, _ = filled(blocks, size, border, rng)
    of_blocks, of_border = rng.normal(size=(count, rows, size)), rng.normal(size=(rows, border))
    A = np.zeros((rows, blocks * size + border))
    A[:, first * size : (first + count) * size] = np.hstack(list(of_blocks))
    A[:, blocks * size :] = of_border
    factor = factorise(system)
    found = covariance_of(factor, marginal_covariances(factor), first, of_blocks, of_border)
    dense = A @ np.linalg.inv(H) @ A.T
    assert np.allclose(found, dense, rtol=0, atol=TOLERANCE * dense.max())


def test_the_factors_take_the_place_of_the_blocks_and_of_nothing_else() -> None:
    system, _, _ = filled(3, 4, 2, np.random.default_rng(1))
    before = [system.rhs.copy(), system.border.copy(), system.border_rhs.copy()]
    factor = factorise(system)
    marginal_covariances(factor)
    assert factor.own is system.diagonal
    after = [system.rhs, system.border, system.border_rhs]
    assert all(np.array_equal(a, b) for a, b in zip(before, after, strict=True))


def test_an_indefinite_system_names_its_block() -> None:
    system, _, _ = filled(3, 4, 0, np.random.default_rng(2))
    system.diagonal[1] -= 1e6 * np.eye(4)
    with pytest.raises(FilterDivergence, match="block 1 of 3"):
        factorise(system)
