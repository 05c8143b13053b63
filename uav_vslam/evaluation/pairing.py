# SPDX-License-Identifier: Apache-2.0
"""Pairs each estimate with ground truth, interpolated or nearest."""

import numpy as np

from uav_vslam.evaluation.trajectory import Trajectory, interpolate
from uav_vslam.numerics import nearest

ASSOCIATIONS = ("interpolate", "nearest")
MAX_GAP_S = 0.5  # ground truth isn't interpolated across a longer gap
MAX_DIFFERENCE_NS = 10_000_000  # of nearest stamps


def pair_with_truth(
    estimate: Trajectory,
    truth: Trajectory,
    *,
    association: str = "interpolate",
    max_gap_s: float = MAX_GAP_S,
) -> tuple[Trajectory, Trajectory]:
    """Return the estimates that have ground truth, and the ground truth of each.

    Args:
        estimate, truth: trajectories.
        association: "interpolate" takes the truth at the estimate's stamp, linearly and by slerp; "nearest" takes the
            nearest true pose and leaves out estimates with none within `MAX_DIFFERENCE_NS`.
        max_gap_s: "interpolate" leaves out estimates within longer gaps of the truth [s].
    """
    if association not in ASSOCIATIONS:
        raise ValueError(f"association {association!r} is not known; use one of {', '.join(ASSOCIATIONS)}")
    if association == "interpolate":
        at_estimate, rows = interpolate(truth, estimate.stamps_ns, max_gap_s=max_gap_s)
        return estimate.select(rows), at_estimate
    if len(truth) == 0 or len(estimate) == 0:
        return estimate.select(np.zeros(0, np.intp)), truth.select(np.zeros(0, np.intp))
    return _nearest(estimate, truth)


def _nearest(estimate: Trajectory, truth: Trajectory) -> tuple[Trajectory, Trajectory]:
    """Pair each estimate with the nearest truth; of estimates that share one, the nearest keeps it."""
    partners = nearest(estimate.stamps_ns, truth.stamps_ns)
    gap = np.abs(truth.stamps_ns[partners] - estimate.stamps_ns)
    order = np.lexsort((gap, partners))
    _, first = np.unique(partners[order], return_index=True)
    rows = np.sort(order[first])
    rows = rows[gap[rows] <= MAX_DIFFERENCE_NS]
    return estimate.select(rows), truth.select(partners[rows])
