# SPDX-License-Identifier: Apache-2.0
"""Descriptor statistics of the landmarks of a map: mean and scatter over all views."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Rows = NDArray[np.intp]

PRIOR_VIEWS = 4.0  # weight of the common variance, in views of the landmark
PRIOR_SHARE = 0.1  # of the variance between landmarks: a landmark's variance before repeated views
MIN_VARIANCE = 1.0 / 12.0  # of rounding to integers


class DescriptorStatistics:
    """Statistics of N landmarks' descriptors of length D, a row each; section 6.4.1 of [thesis].

    Attributes:
        count: (N,) views.
        mean: (N, D) of the descriptors.
        scatter: (N, D) sum of squared deviations from the mean.
    """

    def __init__(self, count: Rows, mean: Array, scatter: Array) -> None:
        self.count, self.mean, self.scatter = count, mean, scatter

    @staticmethod
    def of(descriptors: NDArray[np.uint8]) -> "DescriptorStatistics":
        """Return the statistics of landmarks seen once, with (N, D) descriptors."""
        return DescriptorStatistics(
            np.ones(len(descriptors), np.intp), descriptors.astype(float), np.zeros(descriptors.shape)
        )

    def chosen(self, rows: Rows | NDArray[np.bool_]) -> "DescriptorStatistics":
        """Return the statistics of some of the landmarks."""
        return DescriptorStatistics(self.count[rows], self.mean[rows], self.scatter[rows])

    def append(self, descriptors: NDArray[np.uint8]) -> None:
        """Add new landmarks with (M, D) descriptors; the very first set D."""
        new = DescriptorStatistics.of(descriptors)
        self.mean = np.vstack([self.mean, new.mean]) if len(self.count) else new.mean
        self.scatter = np.vstack([self.scatter, new.scatter]) if len(self.count) else new.scatter
        self.count = np.concatenate([self.count, new.count])

    def observe(self, rows: Rows, descriptors: NDArray[np.uint8]) -> None:
        """Add a view of K landmarks, each at most once, with (K, D) descriptors."""
        self.count[rows] += 1
        mean = self.mean[rows]
        before = descriptors - mean
        self.mean[rows] = mean = mean + before / self.count[rows, None]
        self.scatter[rows] += before * (descriptors - mean)

    def variance(self) -> Array:
        """Return (N, D), each landmark's variance, shrunk towards the common one.

        A few views of 128 numbers do not determine their variance, let alone correlations: the covariance is diagonal,
        the landmark's own scatter is weighted by its views, and the common variance by PRIOR_VIEWS.
        """
        between = self.mean.var(axis=0).mean() if len(self.count) else 0.0
        pooled = self.scatter.sum(axis=0) + PRIOR_VIEWS * PRIOR_SHARE * between
        common = pooled / ((self.count - 1).sum() + PRIOR_VIEWS) + MIN_VARIANCE
        own = self.scatter + PRIOR_VIEWS * common
        return np.asarray(own / (self.count - 1 + PRIOR_VIEWS)[:, None])
