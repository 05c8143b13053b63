# SPDX-License-Identifier: Apache-2.0
"""The recorded ground truth as a trajectory for evaluation."""

from uav_vslam.datasets.bag import BagFlight
from uav_vslam.evaluation.trajectory import Trajectory
from uav_vslam.geometry.rotation import quaternion_wxyz_from_rotation


def truth_trajectory(flight: BagFlight) -> Trajectory | None:
    """Return the recorded ground truth as a trajectory, or None."""
    truth = flight.truth()
    if truth is None:
        return None
    return Trajectory(truth.stamps_ns, truth.positions_world, quaternion_wxyz_from_rotation(truth.R_world_body))
