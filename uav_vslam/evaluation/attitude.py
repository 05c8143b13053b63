# SPDX-License-Identifier: Apache-2.0
"""Whether ground truth has an attitude: sources of positions alone, such as GNSS, fill in the identity."""

import math

import numpy as np

from uav_vslam.evaluation.trajectory import Trajectory

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
