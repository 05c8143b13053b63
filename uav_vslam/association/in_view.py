# SPDX-License-Identifier: Apache-2.0
"""Input and interface of the associators."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from uav_vslam.association.descriptor_statistics import DescriptorStatistics
from uav_vslam.config import BackendConfig
from uav_vslam.types import StereoFeatures

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class InView:
    """The N landmarks predicted to be visible in a frame.

    Attributes:
        rows: (N,) of the map.
        expected: (N, 4) predicted stereo pixels.
        S: (N, 4, 4) covariance of the innovations [px^2].
        descriptors: (N, D) newest ones.
        statistics: over all views.
    """

    rows: NDArray[np.intp]
    expected: Array
    S: Array
    descriptors: NDArray[np.uint8]
    statistics: DescriptorStatistics

    def __len__(self) -> int:
        return len(self.rows)

    def chosen(self, rows: NDArray[np.intp]) -> "InView":
        """Return some of the landmarks."""
        return InView(
            self.rows[rows], self.expected[rows], self.S[rows], self.descriptors[rows], self.statistics.chosen(rows)
        )


class Associator(Protocol):
    """Associates features with landmarks; deterministic."""

    def __call__(self, in_view: InView, seen: StereoFeatures, config: BackendConfig) -> NDArray[np.intp]:
        """Return (K, 2) pairs of row in `in_view` and row in `seen`, ascending in `in_view`, none used twice."""
        ...
