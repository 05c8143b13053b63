# SPDX-License-Identifier: Apache-2.0
"""Ground truth in the frame of a vehicle whose start pose defines its map.

Origin and heading are exactly those of the estimated start, so errors and covariances stay comparable. But ground truth
of positions alone has no heading there; it is turned to where the whole estimate fits it best.
"""

from uav_vslam.evaluation.alignment import align_start_pose
from uav_vslam.evaluation.attitude import lacks_attitude
from uav_vslam.evaluation.pairing import MAX_GAP_S, pair_with_truth
from uav_vslam.evaluation.trajectory import Trajectory, interpolate
from uav_vslam.geometry.rotation import quaternion_wxyz_from_rotation, rotation_from_rpy, rpy_from_rotation


def in_start_frame(truth: Trajectory, estimate: Trajectory) -> Trajectory | None:
    """Return the ground truth with the start as origin, and turned about the vertical to the estimated attitude there.

    Args:
        truth: in any frame with z up.
        estimate: from the start on, in its frame.

    Returns:
        None without ground truth at the start.
    """
    start, _ = interpolate(truth, estimate.stamps_ns[:1], max_gap_s=MAX_GAP_S)
    if len(start) == 0:
        return None
    if lacks_attitude(truth, estimate):
        paired, reference = pair_with_truth(estimate, truth)
        R_start_world = align_start_pose(reference.positions, paired.positions).R
    else:
        _, _, heading = rpy_from_rotation(estimate.rotations[0] @ start.rotations[0].T)
        R_start_world = rotation_from_rpy(0.0, 0.0, heading)
    positions = (truth.positions - start.positions[0]) @ R_start_world.T
    return Trajectory(truth.stamps_ns, positions, quaternion_wxyz_from_rotation(R_start_world @ truth.rotations))
