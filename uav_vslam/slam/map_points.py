# SPDX-License-Identifier: Apache-2.0
"""Points of a frame that a map knows: their information about the frame's pose in the map.

With l_i a point in body axes, m_i where the map has it, and W_i the covariance of m_i,

    m_i = R l_i + t + e_i,    e_i ~ N(0, W_i)

is linearised about (position t, map-frame rotation vector of R) in whitened form, like one more frame's observations
whose fourth row is zero.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from uav_vslam.geometry.pose import POSE_DIM, Pose
from uav_vslam.geometry.rotation import skew

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class MapPoints:
    """Some of a frame's points as a map knows them.

    Attributes:
        rows: (M,) indices of the points, each at most once.
        positions: (M, 3) in the map [m].
        covariances: (M, 3, 3) independent errors [m^2].
        T_map_body: first guess of the frame's pose.
    """

    rows: NDArray[np.intp]
    positions: Array
    covariances: Array
    T_map_body: Pose

    def seen(self, count: int) -> NDArray[np.bool_]:
        """Return the mask (count, 1) of the points that the map knows."""
        mask = np.zeros((count, 1), bool)
        mask[self.rows] = True
        return mask

    def appended(
        self, T_map_body: Pose, points: Array, residual: Array, J_pose: Array, J_point: Array
    ) -> tuple[Array, Array, Array]:
        """Return observations with those of the map as one more frame.

        Args:
            T_map_body: pose.
            points: (N, 3) body axes [m].
            residual: (N, K, 4) [sigma].
            J_pose: (N, K, 4, 6) and J_point: (N, K, 4, 3) of the prediction.
        """
        arm = points[self.rows] @ T_map_body.R.T
        whiten = np.linalg.inv(np.linalg.cholesky(self.covariances))
        rows = np.zeros((len(points), 1, residual.shape[2], 1 + POSE_DIM + 3))
        rows[self.rows, 0, :3, :1] = whiten @ (self.positions - arm - T_map_body.t)[..., None]
        rows[self.rows, 0, :3, 1:] = np.concatenate([whiten, -whiten @ skew(arm), whiten @ T_map_body.R], axis=2)
        in_map = rows[..., 0], rows[..., 1 : 1 + POSE_DIM], rows[..., 1 + POSE_DIM :]
        pairs = zip((residual, J_pose, J_point), in_map, strict=True)
        residual, J_pose, J_point = (np.concatenate(pair, axis=1) for pair in pairs)
        return residual, J_pose, J_point
