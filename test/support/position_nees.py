# SPDX-License-Identifier: Apache-2.0
import numpy as np

from uav_vslam.types import NavState, PoseEstimate


def position_nees(estimate: PoseEstimate, truth: NavState) -> float:
    """Return the NEES of the position, per axis."""
    error = estimate.T_map_body.t - truth.T_map_body.t
    return float(error @ np.linalg.solve(estimate.covariance[:3, :3], error) / 3.0)
