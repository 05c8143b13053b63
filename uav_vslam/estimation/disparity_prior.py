# SPDX-License-Identifier: Apache-2.0
"""How far the disparity may be off, when nobody knows whether the calibration is right.

A priori the error is N(0, right^2) or, with the probability of a wrong calibration, N(0, wrong^2). Only the motion
shows which, and slowly: an error of 0.2 px is contradicted by the inertial unit after tens of frames. A narrow prior
alone is over-confident where the calibration is wrong, a wide one costs accuracy where it is right.

Given measurements the posterior is a mixture of two Gaussians, but a filter holds one: that with the mean and variance
of the mixture, by the prior that leads there. This prior is a term of the information, so it can be exchanged at any
time, as if it had been there from the start.

Symbols: with the likelihood N(mu, v) of the measurements alone, a prior N(0, s^2) leads to the mean k mu and the
variance k v, k = s^2 / (s^2 + v). A mixture with weights w has the mean sum(w k) mu and the variance
sum(w k) v + spread.
"""

from dataclasses import dataclass

import numpy as np
from scipy.special import expit, logit

DOUBTED = 0.3  # probability of a wrong calibration; below it, the right one is taken for granted
LEAST_LEARNT = 1e-9  # share of the prior's information: below it, the measurements say nothing yet


@dataclass(frozen=True, slots=True)
class DisparityPrior:
    """A mixture of two Gaussians of mean zero.

    Attributes:
        right_px, wrong_px: standard deviations with a right and with a wrong calibration [px].
        probability: of a wrong one, a priori.
    """

    right_px: float
    wrong_px: float
    probability: float

    @property
    def mixed(self) -> float:
        """Variance of the mixture [px^2]."""
        return (1.0 - self.probability) * self.right_px**2 + self.probability * self.wrong_px**2

    @property
    def variance(self) -> float:
        """Of the prior as long as nothing was measured [px^2]."""
        return self.right_px**2 if self.probability < DOUBTED else self.mixed

    def given(self, mean: float, variance: float, *, prior: float) -> tuple[float, float]:
        """Return the probability of a wrong calibration given the measurements, and the prior to use instead.

        Args:
            mean, variance: of the estimate [px], [px^2].
            prior: variance of the prior in it [px^2].
        """
        measured = _measured(mean, variance, prior)
        if measured is None or self.probability == 0.0:
            return self.probability, self.variance
        mu, v = measured
        weight, k_right, k_wrong = self._posterior(mu, v)
        if weight < DOUBTED:
            return weight, self.right_px**2
        spread = weight * (1.0 - weight) * (k_wrong - k_right) ** 2 * mu**2
        k = min((1.0 - weight) * k_right + weight * k_wrong + spread / v, k_wrong)
        return weight, v * k / (1.0 - k)

    def mean_square(self, mean: float, variance: float, *, prior: float) -> float:
        """Return how far the estimate may be off in mean square [px^2], also where the right one is taken for granted.

        Never below its variance, and where the motion contradicts any calibration, not above that of a wrong one.
        Arguments as of `given`.
        """
        measured = _measured(mean, variance, prior)
        if measured is None:
            return max(self.mixed, variance)
        mu, v = measured
        weight, *shares = self._posterior(mu, v)
        right, wrong = (k * v + (k * mu - mean) ** 2 for k in shares)
        expected = (1.0 - weight) * right + weight * wrong
        return max(min(expected, self.wrong_px**2), variance)

    def _posterior(self, mu: float, v: float) -> tuple[float, float, float]:
        """Return the probability of a wrong calibration given N(mu, v), and k with a right and with a wrong one."""
        right, wrong = self.right_px**2, self.wrong_px**2
        log_ratio = 0.5 * (np.log((v + right) / (v + wrong)) + mu**2 * (1.0 / (v + right) - 1.0 / (v + wrong)))
        return float(expit(logit(self.probability) + log_ratio)), right / (right + v), wrong / (wrong + v)


def _measured(mean: float, variance: float, prior: float) -> tuple[float, float] | None:
    """Return mean and variance that the measurements alone lead to; None if they say nothing yet."""
    learnt = 1.0 / variance - 1.0 / prior
    return None if learnt < LEAST_LEARNT / prior else (mean / (variance * learnt), 1.0 / learnt)
