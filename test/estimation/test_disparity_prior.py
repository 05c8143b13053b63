# SPDX-License-Identifier: Apache-2.0
"""The prior of the disparity's error: what Bayes' rule makes of its mixture, integrated numerically."""

import numpy as np
import pytest

from uav_vslam.estimation.disparity_prior import BETWEEN, DOUBTED, DisparityPrior

RIGHT, WRONG, PROBABILITY = 0.05, 0.3, 0.2
PRIOR = DisparityPrior(RIGHT, WRONG, PROBABILITY)
CLAIMED = (  # probability and standard deviation
    ((1 - PROBABILITY) * (1 - BETWEEN), RIGHT),
    ((1 - PROBABILITY) * BETWEEN, np.sqrt(RIGHT * WRONG)),
    (PROBABILITY, WRONG),
)
GRID = np.linspace(-3.0, 3.0, 200_001)


def density(x: np.ndarray, sigma: float) -> np.ndarray:
    return np.exp(-0.5 * (x / sigma) ** 2) / (sigma * np.sqrt(2.0 * np.pi))


def estimate(mu: float, v: float, prior: float) -> tuple[float, float]:
    """Return mean and variance of an estimate from a measurement of mu with a variance v."""
    variance = 1.0 / (1.0 / v + 1.0 / prior)
    return variance * mu / v, variance


def given(mu: float, v: float, prior: float = RIGHT**2) -> tuple[float, float]:
    return PRIOR.given(*estimate(mu, v, prior), prior=prior)


@pytest.mark.parametrize("mu", [0.0, 0.1, 0.2, 0.3, -0.5])
@pytest.mark.parametrize("sigma", [0.03, 0.1, 0.2])
def test_probability_and_variance_are_those_of_the_posterior(mu: float, sigma: float) -> None:
    parts = [w * density(GRID, s) for w, s in ((1 - PROBABILITY, RIGHT), (PROBABILITY, WRONG))]
    right, wrong = (part * density(mu - GRID, sigma) for part in parts)
    both = right + wrong
    weight, prior = given(mu, sigma**2)
    np.testing.assert_allclose(weight, wrong.sum() / both.sum(), rtol=1e-6)
    if weight < DOUBTED:
        assert prior == RIGHT**2
        return
    mean = (GRID * both).sum() / both.sum()
    variance = ((GRID - mean) ** 2 * both).sum() / both.sum()
    assert RIGHT**2 < prior <= WRONG**2
    of_wrong = estimate(mu, sigma**2, WRONG**2)[1]  # never wider than with a wrong calibration
    np.testing.assert_allclose(estimate(mu, sigma**2, prior)[1], min(variance, of_wrong), rtol=1e-6)


@pytest.mark.parametrize("mu", [0.02, 0.2, 0.4])
def test_the_verdict_does_not_depend_on_the_prior_in_use(mu: float) -> None:
    for prior in (0.1**2, WRONG**2):
        np.testing.assert_allclose(given(mu, 0.01, prior), given(mu, 0.01), rtol=1e-9)


def test_a_right_calibration_is_assumed_until_measured_and_a_doubted_one_is_not() -> None:
    assert PRIOR.variance == RIGHT**2
    doubted = DisparityPrior(RIGHT, WRONG, 0.5)
    np.testing.assert_allclose(doubted.variance, 0.5 * (RIGHT**2 + WRONG**2), rtol=1e-12)
    for prior in (PRIOR, doubted):
        assert prior.given(0.0, prior.variance, prior=prior.variance) == (prior.probability, prior.variance)


def test_until_it_is_judged_a_calibration_may_be_wrong_unless_that_is_excluded() -> None:
    assert PRIOR.unjudged_variance == WRONG**2
    assert DisparityPrior(RIGHT, WRONG, 0.0).unjudged_variance == RIGHT**2


def test_without_a_wrong_calibration_the_prior_stays() -> None:
    certain = DisparityPrior(RIGHT, WRONG, 0.0)
    assert certain.given(*estimate(1.0, 0.01, RIGHT**2), prior=RIGHT**2) == (0.0, RIGHT**2)


@pytest.mark.parametrize("mu", [0.0, 0.05, 0.1, 0.2, -0.3])
@pytest.mark.parametrize("sigma", [0.03, 0.1, 0.2])
def test_what_is_claimed_is_the_mean_square_about_the_estimate(mu: float, sigma: float) -> None:
    """Whichever prior the estimate was made with."""
    all_kinds = sum(w * density(GRID, s) * density(mu - GRID, sigma) for w, s in CLAIMED)
    for prior in (RIGHT**2, WRONG**2):
        mean, variance = estimate(mu, sigma**2, prior)
        exact = ((GRID - mean) ** 2 * all_kinds).sum() / all_kinds.sum()
        claimed = PRIOR.mean_square(mean, variance, prior=prior)
        np.testing.assert_allclose(claimed, max(min(exact, WRONG**2), variance), rtol=1e-6)


def test_before_any_measurement_the_mixture_itself_is_claimed() -> None:
    mixed = sum(w * s**2 for w, s in CLAIMED)
    np.testing.assert_allclose(PRIOR.mean_square(0.0, RIGHT**2, prior=RIGHT**2), mixed, rtol=1e-12)


def test_a_certain_calibration_claims_what_it_knows() -> None:
    certain = DisparityPrior(RIGHT, WRONG, 0.0)
    mean, variance = estimate(1.0, 0.01, RIGHT**2)
    np.testing.assert_allclose(certain.mean_square(mean, variance, prior=RIGHT**2), variance, rtol=1e-12)
