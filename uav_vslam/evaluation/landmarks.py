# SPDX-License-Identifier: Apache-2.0
"""The landmarks of a whole flight: each as it was last estimated at an epoch."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from uav_vslam.errors import FilterDivergence
from uav_vslam.geometry.pose import POSE_DIM
from uav_vslam.numerics import inverse_spd
from uav_vslam.types import JointInformation

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class MappedLandmarks:
    """Landmarks in the map frame.

    Attributes:
        ids: (N,) unique identifiers.
        positions: (N, 3) [m].
        covariances: (N, 3, 3) [m^2].
    """

    ids: NDArray[np.uint32]
    positions: Array
    covariances: Array

    def __len__(self) -> int:
        return len(self.ids)


def mapped_landmarks(joints: Sequence[JointInformation]) -> MappedLandmarks:
    """Return every landmark that was in the state at an epoch, as the last such epoch has it.

    An epoch whose information is not positive definite is passed over.
    """
    seen: set[int] = set()
    parts = [_unseen(joint, seen) for joint in reversed(joints)]
    return MappedLandmarks(
        np.concatenate([np.zeros(0, np.uint32), *(part.ids for part in parts)]),
        np.concatenate([np.zeros((0, 3)), *(part.positions for part in parts)]),
        np.concatenate([np.zeros((0, 3, 3)), *(part.covariances for part in parts)]),
    )


def _unseen(joint: JointInformation, seen: set[int]) -> MappedLandmarks:
    """Return the landmarks of an epoch that are not in `seen`, and add them."""
    rows = np.array([row for row, identifier in enumerate(joint.ids.tolist()) if identifier not in seen], np.intp)
    try:
        P = inverse_spd(joint.information, "joint information") if len(rows) else np.zeros((POSE_DIM, POSE_DIM))
    except FilterDivergence:
        rows, P = rows[:0], np.zeros((POSE_DIM, POSE_DIM))
    seen.update(joint.ids[rows].tolist())
    own = POSE_DIM + 3 * rows[:, None] + np.arange(3)
    return MappedLandmarks(joint.ids[rows], joint.positions[rows], P[own[:, :, None], own[:, None, :]])
