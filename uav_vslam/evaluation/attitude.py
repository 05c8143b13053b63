# SPDX-License-Identifier: Apache-2.0
"""Whether ground truth has the body's attitude.

Sources of positions alone, such as GNSS, fill in the identity; a motion capture has axes of its own.
"""

import math

import numpy as np

from uav_vslam.evaluation.alignment import align_yaw
from uav_vslam.evaluation.trajectory import Trajectory
from uav_vslam.geometry.rotation import nearest_rotation, rotation_from_quaternion_wxyz, so3_log

SAME = 1e-9  # largest difference of quaternions that are one: a sensor's differ by more
LEAST_TURN_RAD = math.radians(10.0)  # of an estimate: more than its errors


def lacks_attitude(truth: Trajectory, estimate: Trajectory) -> bool:
    """Return whether ground truth has one orientation throughout, though the estimate turns."""
    return never_turns(truth) and largest_turn_rad(estimate) > LEAST_TURN_RAD


def never_turns(trajectory: Trajectory) -> bool:
    """Return whether three or more poses have one orientation, as no vehicle keeps it."""
    return len(trajectory) >= 3 and bool(np.ptp(trajectory.quaternions_wxyz, axis=0).max() <= SAME)


def largest_turn_rad(trajectory: Trajectory) -> float:
    """Return the largest angle between a pose and the first one [rad]; 0 if there are none."""
    if len(trajectory) == 0:
        return 0.0
    cosines = np.abs(trajectory.quaternions_wxyz @ trajectory.quaternions_wxyz[0])
    return float(2.0 * np.arccos(np.clip(cosines.min(), 0.0, 1.0)))


def turn_between(estimate: Trajectory, truth: Trajectory) -> tuple[float, float]:
    """Return by how much the axes of truth are turned against those of an estimate, of equal stamps.

    Headings are compared after the alignment of positions, and tell nothing where these disagree.

    Returns:
        The angle of the mean turn, and its doubt: root mean square of the poses' turns about it and of the positions'
        errors, over their distance from their mean [rad].
    """
    T_truth_estimate = align_yaw(estimate.positions, truth.positions)
    R_estimate, R_truth = (rotation_from_quaternion_wxyz(one.quaternions_wxyz) for one in (estimate, truth))
    turns = np.swapaxes(T_truth_estimate.R @ R_estimate, -1, -2) @ R_truth
    mean = nearest_rotation(turns.sum(axis=0))
    scatter = so3_log(turns @ mean.T)
    errors = T_truth_estimate.apply(estimate.positions) - truth.positions
    doubt2 = np.mean(np.sum(scatter**2, axis=-1)) + np.mean(errors**2) / np.mean(truth.positions.var(axis=0))
    return float(np.linalg.norm(so3_log(mean))), float(np.sqrt(doubt2))
