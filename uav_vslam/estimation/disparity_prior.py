# SPDX-License-Identifier: Apache-2.0
"""How far the disparity may be off, when nobody knows whether the calibration is right.

A priori the error is N(0, right^2) or, with the probability of a wrong calibration, N(0, wrong^2). Only the motion
shows which, and slowly: an error of 0.2 px is contradicted by the inertial unit after tens of frames. A narrow prior
alone is over-confident where the calibration is wrong, a wide one costs accuracy where it is right.

Given measurements the posterior is a mixture of two Gaussians, but a filter holds one: that with the mean and variance
of the mixture, by the prior that leads there. This prior is a term of the information, so it can be exchanged at any
time, as if it had been there from the start. It can be the wide one until there is enough to judge by.

Symbols: with the likelihood N(mu, v) of the measurements alone, a prior N(0, s^2) leads to the mean k mu and the
variance k v, k = s^2 / (s^2 + v). A mixture with weights w has the mean sum(w k) mu and the variance
sum(w k) v + spread.

What is claimed allows for more than these two: many calibrations are in between, as a board leaves them, and a flight
can't distinguish those from right ones. They don't matter for the mean, which is not moved by what can't be observed.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

DOUBTED = 0.3  # probability of a wrong calibration; below it, the right one is taken for granted
BETWEEN = 0.4  # share of calibrations that are not wrong, but neither right
LEAST_LEARNT = 1e-9  # share of the prior's information: below it, the measurements say nothing yet


@dataclass(frozen=True, slots=True)
class DisparityPrior:
    """A mixture of Gaussians of mean zero: two for the mean, and one between them, on a logarithmic scale, for claims.

    Attributes:
        right_px, wrong_px: standard deviations with a right and with a wrong calibration [px].
        probability: of a wrong one, a priori.
    """

    right_px: float
    wrong_px: float
    probability: float

    @property
    def unjudged_variance(self) -> float:
        """Of the prior while there is not enough to judge by [px^2]."""
        return self.wrong_px**2 if self.probability else self.right_px**2

    @property
    def variance(self) -> float:
        """Of the prior as long as nothing was measured [px^2]."""
        weights, variances = self._two
        return self.right_px**2 if self.probability < DOUBTED else float(weights @ variances)

    @property
    def claimed_variance(self) -> float:
        """Of what is claimed as long as nothing was measured [px^2]."""
        return self.mean_square(0.0, self.variance, prior=self.variance)

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
        weights, k = _posterior(mu, v, *self._two)
        wrong = float(weights[1])
        if wrong < DOUBTED:
            return wrong, self.right_px**2
        spread = wrong * (1.0 - wrong) * float(k[1] - k[0]) ** 2 * mu**2
        share = min(float(weights @ k) + spread / v, float(k[1]))
        return wrong, v * share / (1.0 - share)

    def mean_square(self, mean: float, variance: float, *, prior: float) -> float:
        """Return how far the estimate may be off in mean square [px^2], also where the right one is taken for granted.

        Never below its variance, and where the motion contradicts any calibration, not above that of a wrong one.
        Arguments as of `given`.
        """
        if self.probability == 0.0:
            return variance
        measured = _measured(mean, variance, prior)
        weights, variances = self._three
        if measured is None:
            return max(float(weights @ variances), variance)
        mu, v = measured
        weights, k = _posterior(mu, v, weights, variances)
        expected = float(weights @ (k * v + (k * mu - mean) ** 2))
        return max(min(expected, self.wrong_px**2), variance)

    @property
    def _two(self) -> tuple[Array, Array]:
        """Probabilities and variances of right and wrong calibrations."""
        return np.array([1.0 - self.probability, self.probability]), np.array([self.right_px, self.wrong_px]) ** 2

    @property
    def _three(self) -> tuple[Array, Array]:
        """Those of right ones, those between, and wrong ones."""
        not_wrong, wrong = 1.0 - self.probability, self.probability
        sigma_px = np.array([self.right_px, (self.right_px * self.wrong_px) ** 0.5, self.wrong_px])
        return np.array([(1.0 - BETWEEN) * not_wrong, BETWEEN * not_wrong, wrong]), sigma_px**2


def _posterior(mu: float, v: float, weights: Array, variances: Array) -> tuple[Array, Array]:
    """Return the probabilities of priors N(0, variance) given a measurement N(mu, v), and k with each."""
    total = variances + v
    log_likelihood = -0.5 * (np.log(total) + mu**2 / total)
    joint = weights * np.exp(log_likelihood - log_likelihood.max())
    return joint / joint.sum(), variances / total


def _measured(mean: float, variance: float, prior: float) -> tuple[float, float] | None:
    """Return mean and variance that the measurements alone lead to; None if they say nothing yet."""
    learnt = 1.0 / variance - 1.0 / prior
    return None if learnt < LEAST_LEARNT / prior else (mean / (variance * learnt), 1.0 / learnt)
