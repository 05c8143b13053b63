# SPDX-License-Identifier: Apache-2.0
"""How the landmarks of a map have looked so far: mean and scatter of each one's descriptors."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Rows = NDArray[np.intp]

PRIOR_VIEWS = 4.0  # views that the common variance counts for beside a landmark's own
PRIOR_SHARE = 0.1  # of the variance between landmarks: what one landmark's is before any has been seen twice
LEAST_VARIANCE = 1.0 / 12.0  # that rounding to whole numbers leaves


class DescriptorStatistics:
    """Statistics of N landmarks' descriptors of D numbers, a row each; section 6.4.1 of [thesis].

    Attributes:
        count: (N,) views.
        mean: (N, D) of the descriptors.
        scatter: (N, D) sum of squared deviations from the mean.
    """

    def __init__(self, count: Rows, mean: Array, scatter: Array) -> None:
        self.count, self.mean, self.scatter = count, mean, scatter

    @staticmethod
    def of(descriptors: NDArray[np.uint8]) -> "DescriptorStatistics":
        """Return the statistics of landmarks that have been seen once."""
        return DescriptorStatistics(
            np.ones(len(descriptors), np.intp), descriptors.astype(float), np.zeros(descriptors.shape)
        )

    def chosen(self, rows: Rows | NDArray[np.bool_]) -> "DescriptorStatistics":
        """Return the statistics of some of the landmarks."""
        return DescriptorStatistics(self.count[rows], self.mean[rows], self.scatter[rows])

    def append(self, descriptors: NDArray[np.uint8]) -> None:
        """Add landmarks seen for the first time; the first ever decide D."""
        new = DescriptorStatistics.of(descriptors)
        self.mean = np.vstack([self.mean, new.mean]) if len(self.count) else new.mean
        self.scatter = np.vstack([self.scatter, new.scatter]) if len(self.count) else new.scatter
        self.count = np.concatenate([self.count, new.count])

    def observe(self, rows: Rows, descriptors: NDArray[np.uint8]) -> None:
        """Take in another view of landmarks, each at most once."""
        self.count[rows] += 1
        before = descriptors - self.mean[rows]
        self.mean[rows] += before / self.count[rows, None]
        self.scatter[rows] += before * (descriptors - self.mean[rows])

    def variance(self) -> Array:
        """Return (N, D), each landmark's variance, drawn to the one that all have in common.

        A few views of 128 numbers say little of their variance and nothing of their correlations: the covariance is
        diagonal, the landmark's own scatter counts as many views as there were, and what landmarks have in common
        counts PRIOR_VIEWS more.
        """
        between = self.mean.var(axis=0).mean() if len(self.count) else 0.0
        pooled = self.scatter.sum(axis=0) + PRIOR_VIEWS * PRIOR_SHARE * between
        common = pooled / ((self.count - 1).sum() + PRIOR_VIEWS) + LEAST_VARIANCE
        own = self.scatter + PRIOR_VIEWS * common
        return np.asarray(own / (self.count - 1 + PRIOR_VIEWS)[:, None])
