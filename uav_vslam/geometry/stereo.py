# SPDX-License-Identifier: Apache-2.0
"""The stereo rig: two pinhole cameras fixed to the body, in any relative pose (no rectification is assumed).

An observation is `z = [u_left, v_left, u_right, v_right]` in undistorted pixels, Eq. (4.6.13) of [thesis].
"""

import dataclasses
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from uav_vslam.errors import CalibrationError
from uav_vslam.geometry.camera import PinholeCamera
from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.rotation import skew

Array = NDArray[np.float64]

SIDES = ("left", "right")  # the cameras, in the order of all pairs
STEREO_DOF = 4  # coordinates of an observation
MIN_BASELINE_M = 1e-3
MIN_SHARE_ACROSS = 1e-3  # of the baseline, across the optical axis: along it, disparity has no direction


@dataclass(frozen=True, slots=True)
class StereoRig:
    """Calibration of one vehicle's cameras.

    Attributes:
        left, right: intrinsics; "left" is the reference camera (the front one of the Kagaru rig).
        T_body_left, T_body_right: poses of the optical frames in the body (IMU) frame.
        T_right_left: maps left-camera coordinates to right-camera coordinates.
    """

    left: PinholeCamera
    right: PinholeCamera
    T_body_left: Pose
    T_body_right: Pose
    T_right_left: Pose = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "T_right_left", self.T_body_right.inverse() @ self.T_body_left)
        if self.left.size != self.right.size:
            raise CalibrationError(
                f"left images are {self.left.width}x{self.left.height} px but right ones "
                f"{self.right.width}x{self.right.height}; record both cameras at the same size"
            )
        if self.baseline_m < MIN_BASELINE_M:
            raise CalibrationError(
                f"baseline is {self.baseline_m:.2e} m; check where /tf_static or the calibration places both cameras"
            )
        if np.linalg.norm(self.T_right_left.t[:2]) < MIN_SHARE_ACROSS * self.baseline_m:
            raise CalibrationError(
                f"the cameras are {self.baseline_m:g} m apart along their optical axis, and none across it; check "
                "whether /tf_static or the calibration has optical axes: x right, y down, z forward"
            )

    @property
    def baseline_m(self) -> float:
        """Distance between the two optical centres [m]."""
        return float(np.linalg.norm(self.T_body_right.t - self.T_body_left.t))

    @property
    def disparity_axis(self) -> Array:
        """(2,) unit vector in the right image along which disparity moves a point near the optical axis."""
        along = np.array([self.right.fx, self.right.fy]) * self.T_right_left.t[:2]
        return np.asarray(along / np.linalg.norm(along))

    def disparity_shifted(self, shift_px: float) -> "StereoRig":
        """Return the rig whose right principal point lies further along the disparity, by a distance [px]."""
        du, dv = shift_px * self.disparity_axis
        return dataclasses.replace(
            self, right=dataclasses.replace(self.right, cx=self.right.cx + du, cy=self.right.cy + dv)
        )

    def right_magnified(self, share: float) -> "StereoRig":
        """Return the rig whose right camera has focal lengths longer by a share of them."""
        return dataclasses.replace(self, right=self.right.magnified(share))

    @property
    def fundamental(self) -> Array:
        """(3, 3) F with x_right^T F x_left = 0 for undistorted homogeneous pixels."""
        T = self.T_right_left
        F = np.linalg.inv(self.right.K).T @ skew(T.t) @ T.R @ np.linalg.inv(self.left.K)
        return np.asarray(F / np.linalg.norm(F))

    def project(self, points_left: ArrayLike) -> Array:
        """Project (..., 3) points of the left camera frame [m] to (..., 4) stereo pixels."""
        p = np.asarray(points_left, dtype=float)
        return np.concatenate([self.left.project(p), self.right.project(self.T_right_left.apply(p))], axis=-1)

    def project_jacobian(self, points_left: ArrayLike) -> Array:
        """Return dz/d(point): (..., 4, 3) [px/m]."""
        p = np.asarray(points_left, dtype=float)
        T = self.T_right_left
        return np.concatenate([self.left.project_jacobian(p), self.right.project_jacobian(T.apply(p)) @ T.R], axis=-2)

    def magnification(self, pixels: ArrayLike) -> Array:
        """Return (...,) how many times larger errors of raw pixels are at (..., 4) undistorted ones, see the camera's.

        The root mean square of both cameras.
        """
        z = np.asarray(pixels, dtype=float)
        left, right = self.left.magnification(z[..., :2]), self.right.magnification(z[..., 2:])
        return np.asarray(np.sqrt(0.5 * (left**2 + right**2)))

    def triangulate(self, pixels: ArrayLike, *, refinements: int = 2) -> Array:
        """Triangulate stereo pixels: midpoint of the rays, then Gauss-Newton refinement.

        Args:
            pixels: (N, 4) undistorted stereo pixels.
            refinements: number of Gauss-Newton steps.

        Returns:
            (N, 3) points in the left camera frame [m]; a row is NaN where the rays are parallel, diverge, or meet
            behind either camera.
        """
        z = np.asarray(pixels, dtype=float).reshape(-1, 4)
        T_left_right = self.T_right_left.inverse()
        ray_left = self.left.bearings(z[:, :2])
        ray_right = self.right.bearings(z[:, 2:]) @ T_left_right.R.T
        b = T_left_right.t
        # Closest points of the two rays: depth_left * ray_left and b + depth_right * ray_right.
        ll = np.einsum("ni,ni->n", ray_left, ray_left)
        rr = np.einsum("ni,ni->n", ray_right, ray_right)
        lr = np.einsum("ni,ni->n", ray_left, ray_right)
        determinant = ll * rr - lr**2
        good = determinant > 1e-14 * ll * rr
        safe = np.where(good, determinant, 1.0)
        depth_left = (rr * (ray_left @ b) - lr * (ray_right @ b)) / safe
        depth_right = (lr * (ray_left @ b) - ll * (ray_right @ b)) / safe
        good &= (depth_left > 0) & (depth_right > 0)
        points = 0.5 * (depth_left[:, None] * ray_left + b + depth_right[:, None] * ray_right)
        for _ in range(refinements):
            points[~good] = [0.0, 0.0, 1e3 * self.baseline_m]
            J = self.project_jacobian(points)
            residual = z - self.project(points)
            normal = np.einsum("nki,nkj->nij", J, J)
            points = points + np.linalg.solve(normal, np.einsum("nki,nk->ni", J, residual)[..., None])[..., 0]
            good &= (points[:, 2] > 0) & (self.T_right_left.apply(points)[:, 2] > 0)
        points[~good] = np.nan
        return points

    def epipolar_distance(self, pixels: ArrayLike) -> Array:
        """Return (N,) distances [raw px] of right pixels from the epipolar lines of the left ones, for (N, 4) pixels.

        Undistorted distances are divided by the `magnification`, so that noise is as large all over the image.
        """
        return np.abs(self.epipolar_offset(pixels))

    def epipolar_offset(self, pixels: ArrayLike) -> Array:
        """Return (N,) the distances of `epipolar_distance`, with opposite signs on either side of the line."""
        z = np.asarray(pixels, dtype=float).reshape(-1, 4)
        ones = np.ones((len(z), 1))
        lines = np.hstack([z[:, :2], ones]) @ self.fundamental.T
        off = np.einsum("ni,ni->n", np.hstack([z[:, 2:], ones]), lines) / np.linalg.norm(lines[:, :2], axis=1)
        return np.asarray(off / self.magnification(z))
