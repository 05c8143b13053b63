# SPDX-License-Identifier: Apache-2.0
"""A trajectory as arrays, and its interpolation."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.rotation import (
    quaternion_wxyz_from_rotation,
    rotation_from_quaternion_wxyz,
    so3_exp,
    so3_log,
)
from uav_vslam.types import PoseEstimate

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Trajectory:
    """Poses T_map_body in stamp order.

    Attributes:
        stamps_ns: (N,) int64, strictly increasing [ns].
        positions: (N, 3) in the map frame [m].
        quaternions_wxyz: (N, 4) unit quaternions of R_map_body.
        covariance: (N, 6, 6), order position, rotation (map-frame rotation vector), or None if unknown.
    """

    stamps_ns: NDArray[np.int64]
    positions: Array
    quaternions_wxyz: Array
    covariance: Array | None = None

    def __post_init__(self) -> None:
        count = len(self.stamps_ns)
        for name, shape in (("positions", (count, 3)), ("quaternions_wxyz", (count, 4)), ("covariance", (count, 6, 6))):
            value = getattr(self, name)
            if value is not None and value.shape != shape:
                raise ValueError(f"{name} of {count} poses must have shape {shape}, not {value.shape}")
        if count > 1 and not np.all(np.diff(self.stamps_ns) > 0):
            raise ValueError("stamps of a trajectory must strictly increase; sort the poses and drop repeated stamps")

    def __len__(self) -> int:
        return len(self.stamps_ns)

    @staticmethod
    def from_estimates(estimates: Sequence[PoseEstimate]) -> "Trajectory":
        """Build from pose estimates in any order; of those with equal stamps, the last counts."""
        by_stamp = {estimate.stamp_ns: estimate for estimate in estimates}
        ordered = [by_stamp[stamp_ns] for stamp_ns in sorted(by_stamp)]
        return Trajectory(
            np.array([estimate.stamp_ns for estimate in ordered], np.int64),
            np.array([estimate.T_map_body.t for estimate in ordered]).reshape(-1, 3),
            np.array([estimate.T_map_body.quaternion_wxyz for estimate in ordered]).reshape(-1, 4),
            np.array([estimate.covariance for estimate in ordered]).reshape(-1, 6, 6),
        )

    def estimates(self) -> list[PoseEstimate]:
        """Return the poses one by one; their covariance is zero where it is unknown."""
        covariance = np.zeros((len(self), 6, 6)) if self.covariance is None else self.covariance
        rows = zip(self.stamps_ns.tolist(), self.rotations, self.positions, covariance, strict=True)
        return [PoseEstimate(stamp_ns, Pose(R, t), P) for stamp_ns, R, t, P in rows]

    @property
    def rotations(self) -> Array:
        """(N, 3, 3) R_map_body."""
        if len(self) == 0:
            return np.zeros((0, 3, 3))
        return rotation_from_quaternion_wxyz(self.quaternions_wxyz)

    @property
    def path_length_m(self) -> float:
        """Length of the polygon through all positions [m]."""
        return float(np.linalg.norm(np.diff(self.positions, axis=0), axis=1).sum())

    def select(self, rows: NDArray[np.bool_] | NDArray[np.intp]) -> "Trajectory":
        """Return the poses of a mask or of ascending rows."""
        covariance = None if self.covariance is None else self.covariance[rows]
        return Trajectory(self.stamps_ns[rows], self.positions[rows], self.quaternions_wxyz[rows], covariance)

    def between(self, first_ns: int, last_ns: int) -> "Trajectory":
        """Return the poses with first_ns <= stamp <= last_ns."""
        return self.select((self.stamps_ns >= first_ns) & (self.stamps_ns <= last_ns))


def interpolate(
    trajectory: Trajectory, stamps_ns: NDArray[np.int64], *, max_gap_s: float
) -> tuple[Trajectory, NDArray[np.intp]]:
    """Return the trajectory at other stamps: positions linearly, rotations along the geodesic; no extrapolation.

    Args:
        trajectory: poses to interpolate; their covariance is not interpolated.
        stamps_ns: (M,) wanted stamps, strictly increasing [ns].
        max_gap_s: no interpolation between poses farther apart than this [s].

    Returns:
        K <= M interpolated poses, and the (K,) rows of `stamps_ns` that they belong to.
    """
    if len(trajectory) == 0:
        return trajectory.select(np.zeros(0, np.intp)), np.zeros(0, np.intp)
    known = trajectory.stamps_ns
    after = np.searchsorted(known, stamps_ns, side="left").clip(0, len(known) - 1)
    before = np.where(known[after] == stamps_ns, after, after - 1).clip(0)
    inside = (stamps_ns >= known[0]) & (stamps_ns <= known[-1])
    rows = np.flatnonzero(inside & (known[after] - known[before] <= round(max_gap_s * 1e9)))
    before, after, wanted = before[rows], after[rows], stamps_ns[rows]
    span = np.maximum(known[after] - known[before], 1)
    fraction = ((wanted - known[before]) / span)[:, None]
    positions = (1.0 - fraction) * trajectory.positions[before] + fraction * trajectory.positions[after]
    quaternions, between = trajectory.quaternions_wxyz[after], before < after  # elsewhere the pose itself is wanted
    start = trajectory.quaternions_wxyz[before[between]]
    quaternions[between] = _slerp(start, quaternions[between], fraction[between])
    return Trajectory(wanted, positions, quaternions), rows


def _slerp(start_wxyz: Array, end_wxyz: Array, fraction: Array) -> Array:
    """Return (N, 4) quaternions on the shortest path from start to end; fraction is (N, 1)."""
    if len(start_wxyz) == 0:
        return np.zeros((0, 4))
    R_start, R_end = rotation_from_quaternion_wxyz(start_wxyz), rotation_from_quaternion_wxyz(end_wxyz)
    turn = so3_log(R_start.transpose(0, 2, 1) @ R_end)
    return quaternion_wxyz_from_rotation(R_start @ so3_exp(fraction * turn))
