# SPDX-License-Identifier: Apache-2.0
"""The recorded truth as evaluation wants it."""

from uav_vslam.datasets.bag import BagFlight
from uav_vslam.evaluation.trajectory import Trajectory
from uav_vslam.geometry.rotation import quaternion_wxyz_from_rotation


def truth_trajectory(flight: BagFlight) -> Trajectory | None:
    """Return the recorded truth as a trajectory, None where there is none."""
    truth = flight.truth()
    if truth is None:
        return None
    return Trajectory(truth.stamps_ns, truth.positions_world, quaternion_wxyz_from_rotation(truth.R_world_body))
