# SPDX-License-Identifier: Apache-2.0
"""Ground truth in the frame of a vehicle whose start pose defines its map.

Nothing is fitted: origin and heading are exactly those of the start, so errors and covariances stay comparable. But
ground truth of positions alone has no heading there; it is turned to where an estimate fits it best.
"""

import numpy as np

from uav_vslam.evaluation.alignment import align_start_pose
from uav_vslam.evaluation.attitude import lacks_attitude
from uav_vslam.evaluation.pairing import MAX_GAP_S, pair_with_truth
from uav_vslam.evaluation.trajectory import Trajectory, interpolate
from uav_vslam.geometry.rotation import quaternion_wxyz_from_rotation, rotation_from_rpy, rpy_from_rotation


def in_start_frame(truth: Trajectory, start_ns: int, *, estimate: Trajectory | None = None) -> Trajectory | None:
    """Return the ground truth with the start position as origin and zero yaw there.

    Args:
        truth: in any frame with z up.
        start_ns: stamp of the start [ns].
        estimate: from the start on, in its frame; without it, the ground truth must have an attitude.

    Returns:
        None without ground truth at the start.
    """
    start, _ = interpolate(truth, np.array([start_ns], np.int64), max_gap_s=MAX_GAP_S)
    if len(start) == 0:
        return None
    if estimate is not None and lacks_attitude(truth, estimate):
        paired, reference = pair_with_truth(estimate, truth)
        R_start_world = align_start_pose(reference.positions, paired.positions).R
    else:
        R_start_world = rotation_from_rpy(0.0, 0.0, -rpy_from_rotation(start.rotations[0])[2])
    positions = (truth.positions - start.positions[0]) @ R_start_world.T
    return Trajectory(truth.stamps_ns, positions, quaternion_wxyz_from_rotation(R_start_world @ truth.rotations))
