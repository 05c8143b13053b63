# SPDX-License-Identifier: Apache-2.0
"""Rigid transforms: `T_world_body` maps body coordinates to world coordinates."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from uav_vslam.geometry.rotation import quaternion_wxyz_from_rotation, rotation_from_quaternion_wxyz, so3_exp

Array = NDArray[np.float64]

POSE_DIM = 6  # position and rotation, in that order, of errors and of joint estimates of a pose and landmarks


@dataclass(frozen=True, slots=True)
class Pose:
    """A rigid transform x_a = R x_b + t, named `T_a_b` where it is used.

    Attributes:
        R: (3, 3) rotation matrix R_a_b.
        t: (3,) origin of b in a [m].
    """

    R: Array
    t: Array

    @staticmethod
    def identity() -> "Pose":
        """Return the identity transform."""
        return Pose(np.eye(3), np.zeros(3))

    @staticmethod
    def from_quaternion_wxyz(quaternion_wxyz: ArrayLike, t: ArrayLike) -> "Pose":
        """Build from a (4,) Hamilton quaternion and a (3,) translation [m]."""
        return Pose(rotation_from_quaternion_wxyz(quaternion_wxyz), np.asarray(t, dtype=float))

    @staticmethod
    def from_matrix(T: ArrayLike) -> "Pose":
        """Build from a (4, 4) homogeneous matrix."""
        T = np.asarray(T, dtype=float)
        return Pose(T[:3, :3].copy(), T[:3, 3].copy())

    @property
    def quaternion_wxyz(self) -> Array:
        """(4,) unit quaternion with w >= 0."""
        return quaternion_wxyz_from_rotation(self.R)

    @property
    def matrix(self) -> Array:
        """(4, 4) homogeneous matrix."""
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = self.R, self.t
        return T

    def inverse(self) -> "Pose":
        """Return T_b_a."""
        return Pose(self.R.T.copy(), -self.R.T @ self.t)

    def moved(self, step: ArrayLike) -> "Pose":
        """Return the pose after a (6,) shift [m] and rotation vector [rad], both along the axes of frame a."""
        by = np.asarray(step, dtype=float)
        return Pose(so3_exp(by[3:]) @ self.R, self.t + by[:3])

    def __matmul__(self, other: "Pose") -> "Pose":
        """Compose: T_a_c = T_a_b @ T_b_c."""
        return Pose(self.R @ other.R, self.R @ other.t + self.t)

    def apply(self, points: ArrayLike) -> Array:
        """Map (..., 3) points of frame b into frame a."""
        return np.asarray(np.asarray(points, dtype=float) @ self.R.T + self.t)
