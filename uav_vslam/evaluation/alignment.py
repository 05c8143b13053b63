# SPDX-License-Identifier: Apache-2.0
"""Rigid alignment of an estimate to the ground truth, for estimates in another frame.

Source of `se3`: Umeyama, "Least-squares estimation of transformation parameters between two point patterns" (1991),
without scale. `yaw` is its restriction to the four directions that a visual-inertial system can't observe; `start-yaw`
fits the heading alone, for an estimate whose start position is known in the frame of the ground truth; `start-pose`
moves the start as well, so that the error grows from zero as it does in flight.

Positions are (N, 3) [m], N > 0; row k of the estimate is compared with row k of the truth.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.rotation import nearest_rotation, rotation_from_rpy

Array = NDArray[np.float64]


def align_none(estimate: Array, truth: Array) -> Pose:
    """Return the identity, for an estimate in the frame of the ground truth."""
    return Pose.identity()


def align_se3(estimate: Array, truth: Array) -> Pose:
    """Return T_truth_estimate that minimises the squared distances."""
    spread = (truth - truth.mean(axis=0)).T @ (estimate - estimate.mean(axis=0))
    return _through_centres(nearest_rotation(spread), estimate, truth)


def align_yaw(estimate: Array, truth: Array) -> Pose:
    """Return the T_truth_estimate with a rotation about z only that minimises the squared distances."""
    R = _best_yaw(estimate - estimate.mean(axis=0), truth - truth.mean(axis=0))
    return _through_centres(R, estimate, truth)


def align_start_yaw(estimate: Array, truth: Array) -> Pose:
    """Return the T_truth_estimate that rotates about z through the first position of the estimate, which it keeps."""
    R = _best_yaw(estimate - estimate[0], truth - estimate[0])
    return Pose(R, estimate[0] - R @ estimate[0])


def align_start_pose(estimate: Array, truth: Array) -> Pose:
    """Return the T_truth_estimate that maps the first position to the true one, with the best rotation about z."""
    R = _best_yaw(estimate - estimate[0], truth - truth[0])
    return Pose(R, truth[0] - R @ estimate[0])


def _best_yaw(estimate: Array, truth: Array) -> Array:
    """Return the rotation about z that minimises the squared distances of (N, 3) vectors."""
    spread = truth.T @ estimate
    return rotation_from_rpy(0.0, 0.0, np.arctan2(spread[1, 0] - spread[0, 1], spread[0, 0] + spread[1, 1]))


def _through_centres(R: Array, estimate: Array, truth: Array) -> Pose:
    return Pose(R, truth.mean(axis=0) - R @ estimate.mean(axis=0))


ALIGNMENTS: dict[str, Callable[[Array, Array], Pose]] = {
    "none": align_none,
    "start-yaw": align_start_yaw,
    "start-pose": align_start_pose,
    "yaw": align_yaw,
    "se3": align_se3,
}
