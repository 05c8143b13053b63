# SPDX-License-Identifier: Apache-2.0
"""Ground truth in the frame of a vehicle whose start pose defines its map.

Nothing is fitted: origin and heading are exactly those of the start, so errors and covariances stay comparable.
"""

import numpy as np

from uav_vslam.evaluation.pairing import MAX_GAP_S
from uav_vslam.evaluation.trajectory import Trajectory, interpolate
from uav_vslam.geometry.rotation import quaternion_wxyz_from_rotation, rotation_from_rpy, rpy_from_rotation


def in_start_frame(truth: Trajectory, start_ns: int) -> Trajectory | None:
    """Return the ground truth with the start position as origin and zero yaw there.

    Args:
        truth: in any frame with z up.
        start_ns: stamp of the start [ns].

    Returns:
        None without ground truth at the start.
    """
    start, _ = interpolate(truth, np.array([start_ns], np.int64), max_gap_s=MAX_GAP_S)
    if len(start) == 0:
        return None
    yaw = rpy_from_rotation(start.rotations[0])[2]
    R_start_world = rotation_from_rpy(0.0, 0.0, -yaw)
    positions = (truth.positions - start.positions[0]) @ R_start_world.T
    return Trajectory(truth.stamps_ns, positions, quaternion_wxyz_from_rotation(R_start_world @ truth.rotations))
