# SPDX-License-Identifier: Apache-2.0
"""Normal equations of the poses of frames that see common points, with the points eliminated (Schur complement)."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from uav_vslam.geometry.pose import POSE_DIM

Array = NDArray[np.float64]

TINY_INFORMATION = 1e-9  # of unobserved directions, so that the equations stay regular


@dataclass(frozen=True, slots=True)
class PoseEquations:
    """Normal equations of all poses, with the points eliminated.

    Attributes:
        H, b: (6K, 6K) and (6K,) the equations.
        inverse: (N, 3, 3) of the points' own blocks, b_points: (N, 3) their vector, cross: (N, 6K, 3) with the poses.
    """

    H: Array
    b: Array
    inverse: Array
    b_points: Array
    cross: Array

    @staticmethod
    def of(residual: Array, J_pose: Array, J_point: Array, weight: Array) -> "PoseEquations":
        """Eliminate N points from K observations of each.

        Args:
            residual: (N, K, 4).
            J_pose: (N, K, 4, 6) and J_point: (N, K, 4, 3) of the prediction.
            weight: (N, K), 0 where there is no observation.
        """
        count, frames = weight.shape
        W_pose = weight[..., None, None] * J_pose.swapaxes(-1, -2)
        W_point = weight[..., None, None] * J_point.swapaxes(-1, -2)
        own = (W_point @ J_point).sum(axis=1) + TINY_INFORMATION * np.eye(3)
        inverse = np.linalg.inv(own)
        b_points = np.einsum("nkai,nki->na", W_point, residual)
        cross = (W_pose @ J_point).reshape(count, POSE_DIM * frames, 3)
        gain = cross @ inverse
        H = -np.einsum("nai,nbi->ab", gain, cross, optimize=True)
        for k, block in enumerate((W_pose @ J_pose).sum(axis=0)):
            H[POSE_DIM * k : POSE_DIM * (k + 1), POSE_DIM * k : POSE_DIM * (k + 1)] += block
        b = np.einsum("nkai,nki->ka", W_pose, residual).ravel() - np.einsum("nai,ni->a", gain, b_points)
        return PoseEquations(H, b, inverse, b_points, cross)

    def points(self, poses: Array) -> Array:
        """Return the points' step (N, 3) for a step of the poses (6K,), by back-substitution."""
        return np.einsum("nij,nj->ni", self.inverse, self.b_points - np.einsum("nai,a->ni", self.cross, poses))
