# SPDX-License-Identifier: Apache-2.0
"""The H-infinity bound: its formula, its limit for infinite gamma, and its feasibility."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from uav_vslam.estimation.belief import Belief
from uav_vslam.estimation.covariance import CovarianceBelief
from uav_vslam.estimation.h_infinity import ERROR_SCALE, MARGIN, bounded
from uav_vslam.estimation.information import InformationBelief
from uav_vslam.estimation.square_root import SquareRootBelief

Array = NDArray[np.float64]

FORMS = (InformationBelief, CovarianceBelief, SquareRootBelief)
ALL = np.arange(12)
ROUNDING = 1e-7  # 1e-16 times condition numbers of up to 1e8, with a margin
SCALE = np.repeat(ERROR_SCALE, 3)


def some_covariance(seed: int, n: int) -> Array:
    """Return a well-conditioned covariance of correlated errors of about that scale."""
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(n, n)) + 2.0 * np.eye(n)
    sigma = np.concatenate([SCALE, np.full(n - 9, 1e-3)])
    return sigma[:, None] * (A @ A.T + np.eye(n)) * sigma


def feasibility_limit(P: Array) -> float:
    return float(np.linalg.eigvalsh(P[:9, :9] / np.outer(SCALE, SCALE))[-1])


@pytest.mark.parametrize("form", FORMS, ids=lambda form: form.__name__)
@given(st.integers(0, 2**32 - 1), st.sampled_from([9, 15]), st.integers(0, 4), st.floats(0.0, 4.0))
def test_bound_subtracts_the_scaled_navigation_block_from_the_information(
    form: type[Belief], seed: int, nav_dim: int, rig_rows: int, decades: float
) -> None:
    """P <- (P^-1 - gamma^-2 L^T L)^-1; the rows of the biases and of the rig are not bounded, but correlated."""
    P = some_covariance(seed, nav_dim + rig_rows)
    gamma = np.sqrt(MARGIN * feasibility_limit(P)) * 10.0**decades
    belief, feasibility = bounded(form.from_covariance(P), gamma)
    Y = np.linalg.inv(P)
    Y[:9, :9] -= np.diag(1.0 / (gamma * SCALE) ** 2)
    expected, sigma = np.linalg.inv(Y), np.sqrt(np.diag(P))
    found = belief.covariance(np.zeros(0, np.int64))
    np.testing.assert_allclose(found / np.outer(sigma, sigma), expected / np.outer(sigma, sigma), rtol=0, atol=ROUNDING)
    assert feasibility == pytest.approx(gamma**2 / feasibility_limit(P), rel=1e-6)


@given(st.integers(0, 2**32 - 1), st.floats(1e-9, 1e9))
def test_bound_is_feasible_for_any_gamma(seed: int, gamma: float) -> None:
    """P grows by at most 1 / (1 - 1/MARGIN), and never shrinks."""
    P = some_covariance(seed, 15)
    belief, feasibility = bounded(SquareRootBelief.from_covariance(P), gamma)
    assert feasibility >= MARGIN * (1 - 1e-9)
    after = belief.covariance(np.zeros(0, np.int64))
    L = np.linalg.cholesky(P)
    growth = np.linalg.eigvalsh(np.linalg.solve(L, np.linalg.solve(L, after).T))
    assert growth[0] > 1 - ROUNDING
    assert growth[-1] < 1 / (1 - 1 / MARGIN) + ROUNDING


def flown(course, model: str, gamma: float | None) -> tuple[Array, Array, float]:
    """Return a filter's position after three frames, its covariance, and its least feasibility."""
    name, options = ("ukf", {}) if gamma is None else ("uhf", {"gamma": gamma})
    f = course.filter(model, name, **options)
    rng, least = np.random.default_rng(4), np.inf
    f.add_landmarks(course.pixels(0, ALL, rng))
    for frame in range(1, 4):
        f.predict(course.increments[frame - 1])
        least = min(least, f.feasibility)
        f.update(ALL, course.pixels(frame, ALL, rng))
    return np.concatenate([f.nav.T_map_body.t, f.landmarks.ravel()]), f.covariance(), least


@pytest.mark.parametrize("model", ["ri15", "so15", "euler9"])
def test_the_bounded_filter_tends_to_the_unscented_as_gamma_squared(course, model: str) -> None:
    """Ten times the gamma leaves a hundredth of the difference, in mean and covariance."""
    mean, P, _ = flown(course, model, None)
    sigma = np.sqrt(np.diag(P))
    away = []
    for gamma in (1e2, 1e3):
        bounded_mean, bounded_P, _ = flown(course, model, gamma)
        away.append((np.abs(bounded_mean - mean).max(), np.abs((bounded_P - P) / np.outer(sigma, sigma)).max()))
    for near, far in zip(away[1], away[0], strict=True):
        assert far > 1e-6  # the difference is not trivial
        assert near / far == pytest.approx(1e-2, rel=0.02)


@pytest.mark.parametrize("model", ["ri15", "so15", "euler9"])
@pytest.mark.parametrize("gamma", [1e-6, 1.5, 100.0])
def test_the_bounded_filter_stays_feasible_and_definite(course, model: str, gamma: float) -> None:
    mean, P, least = flown(course, model, gamma)
    assert least >= MARGIN * (1 - 1e-9)
    assert np.isfinite(mean).all()
    sigma = np.sqrt(np.diag(P))
    assert np.linalg.eigvalsh(P / np.outer(sigma, sigma))[0] > 0


def test_a_smaller_gamma_is_more_cautious(course) -> None:
    """The bound inflates the covariance, more for smaller gamma, until limited by the margin."""
    volumes = [np.linalg.slogdet(flown(course, "ri15", gamma)[1])[1] for gamma in (1e-6, 1.5, 10.0, 30.0, 100.0, None)]
    assert volumes[0] == pytest.approx(volumes[1])
    assert (np.diff(volumes[1:]) < 0).all()
