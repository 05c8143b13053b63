# SPDX-License-Identifier: Apache-2.0
"""The landmarks of the own map, as a peer's are associated with them."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from uav_vslam.geometry.pose import POSE_DIM
from uav_vslam.types import JointInformation

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class OwnLandmarks:
    """Position, uncertainty and appearance of N landmarks.

    Attributes:
        positions: (N, 3) in the own map frame [m].
        covariance: (3N, 3N) joint covariance [m^2].
        descriptors: (N, D) as extracted; whoever compares them compresses them with the peer's basis.
    """

    positions: Array
    covariance: Array
    descriptors: NDArray[np.uint8]

    @staticmethod
    def of(joint: JointInformation) -> "OwnLandmarks":
        """Return the landmarks of a belief."""
        return OwnLandmarks(joint.positions, joint.covariance[POSE_DIM:, POSE_DIM:], joint.descriptors)

    def __len__(self) -> int:
        return len(self.positions)
