# SPDX-License-Identifier: Apache-2.0
"""The landmarks of a whole flight: each as it was last estimated at an epoch."""

import numpy as np

from uav_vslam.errors import FilterDivergence
from uav_vslam.geometry.pose import POSE_DIM
from uav_vslam.numerics import inverse_spd
from uav_vslam.types import JointInformation, MappedLandmarks

NONE = MappedLandmarks(np.zeros(0, np.uint32), np.zeros((0, 3)), np.zeros((0, 3, 3)))


class LandmarkRecord:
    """Collects every landmark that was in the state at an epoch; the beliefs themselves are not kept."""

    def __init__(self) -> None:
        self._left: list[MappedLandmarks] = []  # of each epoch those that the next one has no more
        self._present = NONE

    def add(self, joint: JointInformation) -> None:
        """Take an epoch's landmarks; pass over one whose information is not positive definite."""
        if not len(joint.ids):
            return
        try:
            present = _landmarks(joint)
        except FilterDivergence:
            return
        self._left.append(_rows(self._present, ~np.isin(self._present.ids, present.ids)))
        self._present = present

    def landmarks(self) -> MappedLandmarks:
        """Return each landmark as the last epoch with it has it, in ascending order of the identifiers."""
        parts = [self._present, *reversed(self._left)]
        together = MappedLandmarks(
            np.concatenate([part.ids for part in parts]),
            np.concatenate([part.positions for part in parts]),
            np.concatenate([part.covariances for part in parts]),
        )
        return _rows(together, np.unique(together.ids, return_index=True)[1])  # of several, `unique` takes the first


def _landmarks(joint: JointInformation) -> MappedLandmarks:
    """Return the landmarks of a belief with the blocks of their covariance."""
    own = POSE_DIM + np.arange(3 * len(joint.ids)).reshape(-1, 3)
    P = inverse_spd(joint.information, "joint information")  # not `joint.covariance`: kept, it takes as much again
    return MappedLandmarks(joint.ids, joint.positions, P[own[:, :, None], own[:, None, :]])


def _rows(landmarks: MappedLandmarks, rows: np.ndarray) -> MappedLandmarks:
    return MappedLandmarks(landmarks.ids[rows], landmarks.positions[rows], landmarks.covariances[rows])
