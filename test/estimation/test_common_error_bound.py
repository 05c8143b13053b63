# SPDX-License-Identifier: Apache-2.0
"""The bound holds, is tight, and recovers covariances that have the form already."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import eigh

from uav_vslam.errors import FilterDivergence
from uav_vslam.estimation.common_error_bound import INDIFFERENCE_M, TOLERANCE, smallest_common_bound
from uav_vslam.geometry.coded_points import block_diagonal, diagonal_blocks, rigid_jacobian

ROUNDING = 1e-6  # of the bound, in units of the covariance


def bound(P: np.ndarray, points: np.ndarray) -> np.ndarray:
    J = rigid_jacobian(points)
    common, own = smallest_common_bound(P, J)
    assert np.array_equal(common, np.tril(common))
    assert np.array_equal(own, np.tril(own))
    return np.asarray(J @ common @ common.T @ J.T + block_diagonal(own @ own.transpose(0, 2, 1)))


def largest_share(P: np.ndarray, R: np.ndarray) -> float:
    return float(eigh(P, R, eigvals_only=True)[-1])


@settings(max_examples=60)
@given(st.integers(0, 2**32 - 1), st.integers(1, 12), st.floats(0.0, 6.0), st.floats(-6, 6))
def test_it_is_an_upper_bound_of_any_covariance(seed: int, count: int, decades: float, log_scale: float) -> None:
    rng = np.random.default_rng(seed)
    Q, _ = np.linalg.qr(rng.normal(size=(3 * count, 3 * count)))
    P = 10.0**log_scale * (Q * 10.0 ** rng.uniform(-decades / 2, decades / 2, 3 * count)) @ Q.T
    R = bound(0.5 * (P + P.T), rng.uniform(-60, 60, (count, 3)))
    assert largest_share(P, R) <= 1.0 + ROUNDING


def test_a_covariance_of_the_form_is_hardly_inflated() -> None:
    rng = np.random.default_rng(0)
    points = rng.uniform(-60, 60, (12, 3))
    J = rigid_jacobian(points)
    own = block_diagonal(np.array([np.diag(rng.uniform(0.1, 0.5, 3) ** 2) for _ in points]))
    P = J @ np.diag([1.0, 1.0, 0.5, 1e-2, 1e-2, 2e-2]) ** 2 @ J.T + own
    R = bound(P, points)
    assert largest_share(P, R) > 0.9  # it is tight
    growth = np.diagonal(R) / np.diagonal(P) - 1.0
    assert 0.0 <= growth.mean() < 2 * TOLERANCE


def test_a_non_rigid_error_costs_far_less_than_with_inflation_of_a_fit() -> None:
    """A stretch along the track: a typical error that is not a rigid motion."""
    rng = np.random.default_rng(1)
    points = rng.uniform(-60, 60, (14, 3))
    J = rigid_jacobian(points)
    stretch = (points * [1.0, 0.0, 0.0]).reshape(-1, 1) / 60.0
    fitted = J @ np.diag([1.0, 1.0, 1.0, 1e-2, 1e-2, 1e-2]) ** 2 @ J.T + 0.1**2 * np.eye(42)
    P = fitted + stretch @ stretch.T
    R = bound(P, points)
    rigid = [np.trace(np.linalg.inv(J.T @ np.linalg.solve(A, J))[:3, :3]) for A in (P, R)]
    assert largest_share(P, fitted) > 100.0
    assert rigid[1] < 2.0 * rigid[0]


def _fitted(P: np.ndarray, J: np.ndarray) -> np.ndarray:
    """Return the common error of a weighted least-squares fit."""
    return np.asarray(np.linalg.inv(J.T @ np.linalg.solve(P, J)))


@pytest.mark.parametrize("seed", range(5))
def test_no_other_split_into_common_and_own_error_costs_less(seed: int) -> None:
    rng = np.random.default_rng(seed)
    points = rng.uniform(-60, 60, (8, 3))
    J, A = rigid_jacobian(points), rng.normal(size=(24, 30))
    P = J @ np.diag([1.0, 1.0, 0.5, 1e-2, 1e-2, 2e-2]) ** 2 @ J.T + 0.02 * A @ A.T
    common, own = smallest_common_bound(P, J)
    shared, alone = J @ common @ common.T @ J.T, block_diagonal(own @ own.transpose(0, 2, 1))
    W = block_diagonal(np.linalg.inv(diagonal_blocks(P) + INDIFFERENCE_M**2 * np.eye(3)))
    cost = np.trace(W @ (shared + alone))
    for weight in (0.1, 0.3, 0.6, 1.5, 3.0, 10.0):
        other = weight * shared + alone
        other *= largest_share(P, other)  # the smallest valid scale
        assert np.trace(W @ other) > cost * (1.0 - TOLERANCE)
    likeliest = J @ _fitted(P, J) @ J.T
    for weight in (0.01, 0.1, 0.3, 1.0, 3.0):
        other = weight * likeliest + block_diagonal(diagonal_blocks(P))
        other *= largest_share(P, other)
        assert np.trace(W @ other) > cost * (1.0 - TOLERANCE)


def test_a_covariance_without_positive_eigenvalues_is_rejected() -> None:
    with pytest.raises(FilterDivergence, match="positive definite"):
        smallest_common_bound(np.zeros((6, 6)), rigid_jacobian(np.eye(3)[:2]))
