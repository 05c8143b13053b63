# SPDX-License-Identifier: Apache-2.0
"""What each scheme makes of the same packet, and where it stops being consistent."""

import dataclasses

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.special import chdtri

from uav_vslam.config import FUSION_SCHEMES, FUSION_WEIGHTS
from uav_vslam.cooperation.schemes import FALSE_ALARM, SCHEMES, Evidence
from uav_vslam.estimation.covariance_intersection import WEIGHTS, Split

Array = NDArray[np.float64]

N, K = 9, 6  # rows of the own state, of what the peer estimates
E = np.eye(N)[N - K :]


def spd(seed: int, n: int) -> Array:
    A = np.random.default_rng(seed).normal(size=(n, n))
    return np.asarray(A @ A.T + 0.1 * np.eye(n))


def own() -> Split:
    return Split(spd(1, N), np.zeros((N, N)))


def evidence(*, dependent: bool) -> Evidence:
    return Evidence(E, np.linspace(-1.0, 1.0, K), spd(2, K), 0.09 * np.eye(K), dependent)


def test_every_name_that_may_be_configured_exists() -> None:
    assert tuple(SCHEMES) == FUSION_SCHEMES
    assert tuple(WEIGHTS) == FUSION_WEIGHTS


@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize("dependent", [False, True])
def test_every_scheme_leaves_a_covariance_no_larger_than_the_own(scheme: str, dependent: bool) -> None:
    fused = SCHEMES[scheme](own(), evidence(dependent=dependent), "position_trace")
    assert np.linalg.eigvalsh(fused.P.total)[0] > 0
    assert np.trace(fused.P.total[:3, :3]) <= np.trace(own().total[:3, :3]) * (1 + 1e-9)
    assert fused.delta.shape == (N,)


def test_what_is_independent_adds_whatever_the_name_of_the_sum() -> None:
    split, added = (SCHEMES[s](own(), evidence(dependent=False), "trace") for s in ("split_ci", "overlay"))
    np.testing.assert_array_equal(split.P.total, added.P.total)
    Y = np.linalg.inv(own().total) + E.T @ np.linalg.inv(spd(2, K) + 0.09 * np.eye(K)) @ E
    np.testing.assert_allclose(split.P.total, np.linalg.inv(Y), rtol=1e-8, atol=1e-10)


def test_what_is_dependent_is_intersected_by_all_but_the_sum() -> None:
    measured = evidence(dependent=True)
    split, full, added = (SCHEMES[s](own(), measured, "trace") for s in ("split_ci", "full_ci", "overlay"))
    np.testing.assert_array_equal(split.P.total, full.P.total)
    assert split.weight < 1.0
    assert np.trace(added.P.total) < np.trace(split.P.total)


def test_only_the_sum_gains_from_the_own_estimate_sent_back() -> None:
    P = spd(3, K)
    echo = Evidence(np.eye(K), np.zeros(K), P, np.zeros((K, K)), dependent=True)
    mine = Split(P, np.zeros_like(P))
    for scheme in ("split_ci", "full_ci", "inverse_ci"):
        np.testing.assert_allclose(SCHEMES[scheme](mine, echo, "trace").P.total, P, rtol=1e-6)
    np.testing.assert_allclose(SCHEMES["overlay"](mine, echo, "trace").P.total, P / 2, rtol=1e-8)


@pytest.mark.parametrize("scheme", ["split_ci", "full_ci"])
def test_an_intersection_is_the_kalman_update_of_the_inflated_shares(scheme: str) -> None:
    """The floor is an independent error: it adds to the peer's share after that was divided by its weight."""
    measured = evidence(dependent=True)
    fused = SCHEMES[scheme](own(), measured, "trace")
    assert 0.0 < fused.weight < 1.0
    P1 = own().total / fused.weight
    S = E @ P1 @ E.T + measured.R / (1.0 - fused.weight) + measured.floor
    K = P1 @ E.T @ np.linalg.inv(S)
    np.testing.assert_allclose(fused.P.total, P1 - K @ S @ K.T, rtol=1e-8, atol=1e-10)
    np.testing.assert_allclose(fused.delta, K @ measured.innovation, rtol=1e-8, atol=1e-10)


@pytest.mark.parametrize(("scheme", "dependent"), [("overlay", True), ("inverse_ci", True), ("split_ci", False)])
def test_where_nothing_is_split_the_floor_is_a_part_of_the_covariance(scheme: str, dependent: bool) -> None:
    measured = evidence(dependent=dependent)
    whole = Evidence(E, measured.innovation, measured.R + measured.floor, np.zeros((K, K)), dependent)
    found, expected = (SCHEMES[scheme](own(), one, "trace") for one in (measured, whole))
    np.testing.assert_allclose(found.P.total, expected.P.total, rtol=1e-12)
    np.testing.assert_allclose(found.delta, expected.delta, rtol=1e-12)


def test_right_evidence_hardly_ever_contradicts_and_what_can_not_be_does() -> None:
    """At 1e-8 none of 1000 draws of the innovation's own covariance may fail; seven sigmas in every direction do."""
    measured = evidence(dependent=False)
    S = E @ own().total @ E.T + measured.R + measured.floor
    L = np.linalg.cholesky(S)
    draws = np.random.default_rng(4).normal(size=(1000, K)) @ L.T
    assert not any(dataclasses.replace(measured, innovation=draw).contradicts(own().total) for draw in draws)
    impossible = dataclasses.replace(measured, innovation=L @ np.full(K, 7.0))
    assert impossible.contradicts(own().total)


def test_dependent_evidence_contradicts_only_beyond_what_any_correlation_allows() -> None:
    measured = evidence(dependent=False)
    S = E @ own().total @ E.T + measured.R + measured.floor
    at_limit = np.sqrt(chdtri(K, FALSE_ALARM) / K) * np.linalg.cholesky(S) @ np.ones(K)
    for dependent, factor, expected in (
        (False, 0.99, False),
        (False, 1.01, True),
        (True, 1.41, False),
        (True, 1.42, True),
    ):
        judged = dataclasses.replace(measured, innovation=factor * at_limit, dependent=dependent)
        assert judged.contradicts(own().total) is expected, (dependent, factor)
