# SPDX-License-Identifier: Apache-2.0
"""The fused covariance bounds the true error for any correlation of the dependent shares; a plain sum does not."""

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from uav_vslam.estimation.covariance_intersection import (
    WEIGHT_BOUNDS,
    WEIGHT_SKIP,
    WEIGHTS,
    EstimatePair,
    Fused,
    Split,
    inverse_covariance_intersection,
    split_covariance_intersection,
)
from uav_vslam.numerics import symmetrise

Array = NDArray[np.float64]

ROUNDING = 1e-9  # relative to the largest eigenvalue
OWN, PEER = 6, 3  # sizes: the peer estimates the last three components
E = np.eye(OWN)[OWN - PEER :]


def trace(P: Array) -> float:
    return float(np.trace(P))


def spd(rng: np.random.Generator, n: int) -> Array:
    Q, _ = np.linalg.qr(rng.normal(size=(n, n)))
    return symmetrise((Q * 10.0 ** rng.uniform(-2, 2, n)) @ Q.T)


def joint(rng: np.random.Generator, own: Split, peer: Split) -> Array:
    """Return the true joint covariance of both errors: dependent shares maximally correlated."""
    L1, L2 = np.linalg.cholesky(own.dependent), np.linalg.cholesky(peer.dependent)
    U, _ = np.linalg.qr(rng.normal(size=(len(L1), len(L1))))
    C = (U * rng.choice([-1.0, 1.0, rng.uniform(-1, 1)], len(L1)))[:, : len(L2)]  # singular values at most one
    J = np.zeros((OWN + PEER, OWN + PEER))
    J[:OWN, :OWN], J[OWN:, OWN:] = own.total, peer.total
    J[:OWN, OWN:] = L1 @ C @ L2.T
    J[OWN:, :OWN] = J[:OWN, OWN:].T
    return J


def true_covariance(fused: Fused, own: Split, peer: Split, J: Array) -> Array:
    """Return the covariance of the fused error, (I - K E) e1 + K e2, for the gain actually used."""
    K = gain(own, peer)
    A = np.hstack([np.eye(OWN) - K @ E, K])
    return np.asarray(A @ J @ A.T)


def gain(own: Split, peer: Split, **options) -> Array:
    """Return the gain, column by column from the correction of unit innovations."""
    columns = [split_covariance_intersection(own, E, e, peer, **options).delta for e in np.eye(PEER)]
    return np.column_stack(columns)


def overconfidence(claimed: Array, true: Array) -> float:
    """Return the smallest eigenvalue of claimed - true, relative to the largest of claimed."""
    return float(np.linalg.eigvalsh(claimed - true)[0] / np.linalg.eigvalsh(claimed)[-1])


@given(st.integers(0, 2**32 - 1), st.booleans())
def test_fusion_is_consistent_for_any_correlation(seed: int, independent_share: bool) -> None:
    rng = np.random.default_rng(seed)
    scale = 1.0 if independent_share else 0.0
    own = Split(scale * spd(rng, OWN), spd(rng, OWN))
    peer = Split(scale * spd(rng, PEER), spd(rng, PEER))
    fused = split_covariance_intersection(own, E, np.zeros(PEER), peer)
    assert overconfidence(fused.P.total, true_covariance(fused, own, peer, joint(rng, own, peer))) >= -ROUNDING
    assert np.linalg.eigvalsh(fused.P.independent)[0] >= -ROUNDING * trace(fused.P.total)
    assert np.linalg.eigvalsh(fused.P.dependent)[0] >= -ROUNDING * trace(fused.P.total)


@given(st.integers(0, 2**32 - 1))
def test_the_independent_share_is_what_the_gain_makes_of_both_independent_shares(seed: int) -> None:
    """Next time it adds, so that it must hold nothing of the dependent ones: (I - K E) P (I - K E)^T + K R K^T."""
    rng = np.random.default_rng(seed)
    own, peer = Split(spd(rng, OWN), spd(rng, OWN)), Split(spd(rng, PEER), spd(rng, PEER))
    fused, K = split_covariance_intersection(own, E, np.zeros(PEER), peer), gain(own, peer)
    A = np.eye(OWN) - K @ E
    expected = A @ own.independent @ A.T + K @ peer.independent @ K.T
    np.testing.assert_allclose(fused.P.independent, expected, rtol=0, atol=ROUNDING * trace(expected) * 10)


def test_a_plain_sum_of_correlated_information_is_overconfident() -> None:
    failed = 0
    for seed in range(50):
        rng = np.random.default_rng(seed)
        own, peer = Split(np.zeros((OWN, OWN)), spd(rng, OWN)), Split(np.zeros((PEER, PEER)), spd(rng, PEER))
        naive_own, naive_peer = (Split(s.dependent, s.independent) for s in (own, peer))
        fused = split_covariance_intersection(naive_own, E, np.zeros(PEER), naive_peer)
        true = true_covariance(fused, naive_own, naive_peer, joint(rng, own, peer))
        failed += overconfidence(fused.P.total, true) < -1e-3
    assert failed > 25


def test_summing_the_same_estimate_twice_halves_its_covariance_and_intersection_does_not() -> None:
    P = np.diag([4.0, 1.0, 9.0])
    zero = np.zeros_like(P)
    innovation = np.zeros(3)
    naive = split_covariance_intersection(Split(P, zero), np.eye(3), innovation, Split(P, zero))
    np.testing.assert_allclose(naive.P.total, P / 2)
    ours = split_covariance_intersection(Split(zero, P), np.eye(3), innovation, Split(zero, P))
    np.testing.assert_allclose(ours.P.total, P)


def test_independent_estimates_give_the_kalman_update() -> None:
    rng = np.random.default_rng(0)
    P, R, innovation = spd(rng, OWN), spd(rng, PEER), rng.normal(size=PEER)
    fused = split_covariance_intersection(Split(P, np.zeros_like(P)), E, innovation, Split(R, np.zeros_like(R)))
    Y = np.linalg.inv(P) + E.T @ np.linalg.inv(R) @ E
    np.testing.assert_allclose(fused.P.total, np.linalg.inv(Y), rtol=1e-8, atol=1e-10)
    np.testing.assert_allclose(fused.delta, np.linalg.solve(Y, E.T @ np.linalg.solve(R, innovation)), rtol=1e-8)
    np.testing.assert_allclose(fused.P.dependent, 0.0, rtol=0, atol=ROUNDING * trace(P))
    assert fused.weight == 1.0


@pytest.mark.parametrize("weight", [0.3, 0.5, 0.9])
def test_fully_dependent_estimates_give_covariance_intersection(weight: float) -> None:
    """Eq. (7.1) of [thesis]: Y = w Y_own + (1 - w) E^T Y_peer E."""
    rng = np.random.default_rng(1)
    P, R, innovation = spd(rng, OWN), spd(rng, PEER), rng.normal(size=PEER)
    fused = split_covariance_intersection(
        Split(np.zeros_like(P), P), E, innovation, Split(np.zeros_like(R), R), weigh=lambda _: weight
    )
    Y = weight * np.linalg.inv(P) + (1 - weight) * E.T @ np.linalg.inv(R) @ E
    np.testing.assert_allclose(fused.P.total, np.linalg.inv(Y), rtol=1e-8, atol=1e-10)
    expected = np.linalg.solve(Y, (1 - weight) * E.T @ np.linalg.solve(R, innovation))
    np.testing.assert_allclose(fused.delta, expected, rtol=1e-8)
    np.testing.assert_allclose(fused.P.independent, 0.0, rtol=0, atol=ROUNDING * trace(P))
    assert fused.weight == weight


COSTS: dict[str, Callable[[Array], float]] = {
    "position_trace": lambda P: trace(P[:3, :3]),
    "trace": trace,
    "determinant": lambda P: float(np.exp(np.linalg.slogdet(P)[1] / OWN)),
}


@pytest.mark.parametrize("criterion", COSTS)
@settings(max_examples=30)
@given(seed=st.integers(0, 2**32 - 1))
@example(seed=320)  # the best weight is just above the one from which on a fusion is skipped
def test_the_weight_minimises_its_cost_within_its_bounds(criterion: str, seed: int) -> None:
    rng, cost = np.random.default_rng(seed), COSTS[criterion]
    own, peer = Split(spd(rng, OWN), spd(rng, OWN)), Split(spd(rng, PEER), spd(rng, PEER))

    def cost_at(weight: float) -> float:
        return cost(split_covariance_intersection(own, E, np.zeros(PEER), peer, weigh=lambda _: weight).P.total)

    fused = split_covariance_intersection(own, E, np.zeros(PEER), peer, weigh=WEIGHTS[criterion])
    assert fused.weight == 1.0 or WEIGHT_BOUNDS[0] <= fused.weight <= WEIGHT_SKIP
    best = min(cost_at(w) for w in np.linspace(WEIGHT_BOUNDS[0], WEIGHT_SKIP - 1e-4, 40))
    pair = EstimatePair(own, E, peer)
    weight = WEIGHTS[criterion](pair)
    assert fused.weight == (1.0 if weight > WEIGHT_SKIP else weight)
    # The search tolerance is 1e-3; what it finds just above the limit is skipped afterwards.
    assert cost(pair.fused(np.zeros(PEER), weight, 1.0 - weight).P.total) <= min(best, cost(own.total)) * 1.01


@pytest.mark.parametrize("name", WEIGHTS)
@given(seed=st.integers(0, 2**32 - 1))
def test_fusion_is_consistent_with_every_weight_criterion(name: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    own, peer = Split(spd(rng, OWN), spd(rng, OWN)), Split(spd(rng, PEER), spd(rng, PEER))
    weight = WEIGHTS[name](EstimatePair(own, E, peer))
    fused = split_covariance_intersection(own, E, np.zeros(PEER), peer, weigh=lambda _: weight)
    if fused.weight < 1.0:
        A = np.eye(OWN) - (K := gain(own, peer, weigh=lambda _: weight)) @ E
        J = joint(rng, own, peer)
        true = np.hstack([A, K]) @ J @ np.hstack([A, K]).T
        assert overconfidence(fused.P.total, true) >= -ROUNDING


def test_closed_form_weights_are_equal_for_equal_estimates_and_favour_the_better_one() -> None:
    zero = np.zeros((PEER, PEER))
    for name in ("niehsen", "franken_hupper"):
        equal = EstimatePair(Split(zero, np.eye(PEER)), np.eye(PEER), Split(zero, np.eye(PEER)))
        better = EstimatePair(Split(zero, np.eye(PEER)), np.eye(PEER), Split(zero, 3.0 * np.eye(PEER)))
        assert WEIGHTS[name](equal) == pytest.approx(0.5)
        assert WEIGHTS[name](better) > 0.6


@given(st.integers(0, 2**32 - 1))
def test_inverse_intersection_is_consistent_for_common_information_and_tighter(seed: int) -> None:
    """Each estimate is a shared prior plus an own measurement [noack17]."""
    rng = np.random.default_rng(seed)
    prior, mine, theirs = (np.linalg.inv(spd(rng, PEER)) for _ in range(3))
    A, B = np.linalg.inv(prior + mine), np.linalg.inv(prior + theirs)
    J = np.block([[A, A @ prior @ B], [B @ prior @ A, B]])
    I = np.eye(PEER)
    fused = inverse_covariance_intersection(A, I, np.zeros(PEER), B)
    K = np.column_stack([inverse_covariance_intersection(A, I, e, B).delta for e in I])
    true = np.hstack([I - K, K]) @ J @ np.hstack([I - K, K]).T
    assert overconfidence(fused.P.total, true) >= -1e-7
    zero = np.zeros_like(A)
    plain = split_covariance_intersection(Split(zero, A), I, np.zeros(PEER), Split(zero, B), weigh=WEIGHTS["trace"])
    assert trace(fused.P.total) <= trace(plain.P.total) * 1.01


def test_an_uninformative_peer_is_skipped() -> None:
    own = Split(np.zeros((OWN, OWN)), np.eye(OWN))
    peer = Split(np.zeros((PEER, PEER)), 1e6 * np.eye(PEER))
    fused = split_covariance_intersection(own, E, np.ones(PEER), peer)
    assert fused.weight == 1.0
    np.testing.assert_array_equal(fused.delta, np.zeros(OWN))
    np.testing.assert_array_equal(fused.P.total, own.total)


def test_inputs_are_not_modified() -> None:
    rng = np.random.default_rng(2)
    own, peer = Split(spd(rng, OWN), spd(rng, OWN)), Split(spd(rng, PEER), spd(rng, PEER))
    before = [a.copy() for a in (own.independent, own.dependent, peer.independent, peer.dependent)]
    split_covariance_intersection(own, E, np.ones(PEER), peer)
    for then, now in zip(before, (own.independent, own.dependent, peer.independent, peer.dependent), strict=True):
        np.testing.assert_array_equal(then, now)
