# SPDX-License-Identifier: Apache-2.0
"""Which landmarks a frame shows, and where."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from uav_vslam.geometry.pose import Pose
from uav_vslam.types import StereoFeatures

Rows = NDArray[np.intp]


@dataclass(frozen=True, slots=True)
class Matches:
    """Pairs of a landmark and a feature that shows it.

    Attributes:
        landmarks, features: (K,) rows of each pair.
        pixels: (K, 4) where the features are [px].
        linearise_at: pose to linearise at; None where the predicted one is near enough.
        relocalised: found without the prediction.
    """

    landmarks: Rows
    features: Rows
    pixels: NDArray[np.float64]
    linearise_at: Pose | None = None
    relocalised: bool = False

    @staticmethod
    def none() -> "Matches":
        """Return no match."""
        return Matches(np.zeros(0, np.intp), np.zeros(0, np.intp), np.zeros((0, 4)))

    @staticmethod
    def of(pairs: Rows, features: StereoFeatures, *, relocalised: bool = False) -> "Matches":
        """Return (K, 2) pairs of a landmark row and a feature row as matches."""
        rows = pairs[:, 1]
        return Matches(pairs[:, 0], rows, features.pixels[rows].astype(float), relocalised=relocalised)

    def __len__(self) -> int:
        return len(self.landmarks)

    def chosen(self, rows: Rows) -> "Matches":
        """Return some of the matches."""
        return Matches(
            self.landmarks[rows], self.features[rows], self.pixels[rows], self.linearise_at, self.relocalised
        )
