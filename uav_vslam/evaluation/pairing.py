# SPDX-License-Identifier: Apache-2.0
"""Pairs each estimate with the ground truth at its stamp."""

from uav_vslam.evaluation.trajectory import Trajectory, interpolate

MAX_GAP_S = 0.5  # ground truth isn't interpolated across a longer gap


def pair_with_truth(
    estimate: Trajectory, truth: Trajectory, *, max_gap_s: float = MAX_GAP_S
) -> tuple[Trajectory, Trajectory]:
    """Return the estimates that have ground truth, and the ground truth at their stamps, linearly and by slerp.

    Args:
        estimate, truth: trajectories.
        max_gap_s: estimates within longer gaps of the truth are left out [s].
    """
    at_estimate, rows = interpolate(truth, estimate.stamps_ns, max_gap_s=max_gap_s)
    return estimate.select(rows), at_estimate
