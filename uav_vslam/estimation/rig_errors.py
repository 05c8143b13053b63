# SPDX-License-Identifier: Apache-2.0
"""Calibration errors of the rig, estimated along with the navigation state.

`attitude`      rotation of the right camera relative to its calibration, in its own frame: a slow random walk
`vibration`     the same, independent in each frame
`disparity`     constant error of the disparity: shift of the right principal point along it
`focal_ratio`   relative error of the right camera's focal length over the left one's, constant
`time_offset`   delay of the exposure: the image shows the pose at stamp + time_offset

A rotation about the axis that changes disparity acts like a scaling of all depths: invisible in the residuals but
observable from the motion, so it is estimated. Unmodelled, 0.02 degrees already cost more than the cameras gain. A
principal point that is off does the same; a rotation can't stand for it with a wide lens, where it bends the image too.

Rotations about the other two axes move the right pixels off their epipolar lines. Each stereo pair shows that, and
calibrations are commonly off by tenths of a pixel, far more than tracked points scatter: unmodelled, none would pass
the gate. So these axes have a wide prior of their own.

Focal lengths that are off against each other move them off by up to 0.4 px at the edges of an image of 1280 by 960 px,
if by 0.05 %, as calibrations are.

Errors of the baseline and of both focal lengths alike change the depths over ground as the disparity does, so they are
no states. Nor is the attitude of the cameras to the IMU: in simulated flights with pixels of 1 px and a disparity of
18 px its estimates were off by up to six of the claimed standard deviations, with 0.1 px they were consistent.
"""

import copy
import dataclasses
import itertools
from dataclasses import dataclass, field
from typing import Self

import numpy as np
from numpy.typing import NDArray

from uav_vslam.config import RigConfig
from uav_vslam.estimation.disparity_prior import DisparityPrior
from uav_vslam.estimation.turning import Turning
from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.rotation import skew, so3_exp
from uav_vslam.geometry.stereo import StereoRig
from uav_vslam.types import NavState

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class RigState:
    """Mean of the rig's errors.

    Attributes:
        attitude, vibration: (3,) rotation vectors of the right camera in its own frame [rad].
        disparity_px: shift of the right principal point, see `StereoRig.disparity_shifted` [px].
        focal_ratio: see `StereoRig.right_magnified`.
        time_offset_s: exposure minus stamp [s].
    """

    attitude: Array = field(default_factory=lambda: np.zeros(3))
    vibration: Array = field(default_factory=lambda: np.zeros(3))
    disparity_px: float = 0.0
    focal_ratio: float = 0.0
    time_offset_s: float = 0.0


class RigErrors:
    """Layout of the rig's rows in the vehicle's error, after `first` navigation rows, and their models."""

    def __init__(self, rig: StereoRig, config: RigConfig, first: int) -> None:
        self._rig = rig
        attitude = config.attitude_sigma_deg if config.flexing else config.rigid_sigma_deg
        vibration = config.vibration_sigma_deg if config.flexing else 0.0
        probability = 0.0 if config.flexing else config.miscalibrated_probability
        self.disparity_prior = DisparityPrior(config.disparity_sigma_px, config.miscalibrated_sigma_px, probability)
        angles = np.deg2rad([attitude, vibration])
        disparity = self.disparity_prior.variance**0.5 if config.disparity_sigma_px else 0.0
        sigma = np.array([*angles, disparity, config.focal_ratio_sigma, config.time_offset_sigma_s])
        sizes = np.array([3, 3, 1, 1, 1]) * (sigma > 0)
        ends = first + np.cumsum([0, *sizes])
        self.attitude, self.vibration, self.disparity, self.focal_ratio, self.time_offset = (
            slice(int(start), int(end)) for start, end in itertools.pairwise(ends)
        )
        self.rows = slice(first, int(ends[-1]))
        self.dim = int(ends[-1]) - first
        self.vibration_variance = float(angles[1] ** 2)
        self._walk_variance = float(np.deg2rad(config.attitude_walk_deg) ** 2) if config.flexing else 0.0
        self.prior_covariance: Array = np.diag(np.repeat(sigma, sizes) ** 2)
        if attitude > 0 and not config.flexing:
            self.prior_covariance[:3, :3] = _attitude_covariance(rig, attitude, config.epipolar_sigma_deg)

    @property
    def has_disparity(self) -> bool:
        """Whether the disparity's error is a state."""
        return self.disparity.stop > self.disparity.start

    @property
    def has_time_offset(self) -> bool:
        """Whether the offset of the cameras' clock is a state."""
        return self.time_offset.stop > self.time_offset.start

    @property
    def has_vibration(self) -> bool:
        """Whether the right camera's vibration is a state."""
        return self.vibration.stop > self.vibration.start

    @property
    def disparity_variance(self) -> float:
        """Of the prior in use [px^2]."""
        row = self.disparity.start - self.rows.start
        return float(self.prior_covariance[row, row])

    def with_disparity_variance(self, variance: float) -> Self:
        """Return the same errors with another prior of the disparity [px^2]."""
        other = copy.copy(self)
        other.prior_covariance = self.prior_covariance.copy()
        row = self.disparity.start - self.rows.start
        other.prior_covariance[row, row] = variance
        return other

    def noise_variance(self, dt_s: float) -> Array:
        """Return (dim,) variance that the random walk adds over a time."""
        variance = np.zeros(self.dim)
        variance[: self.attitude.stop - self.attitude.start] = self._walk_variance * dt_s
        return variance

    def retract(self, state: RigState, delta: Array) -> RigState:
        """Apply a correction of the vehicle's error to a mean."""
        attitude, vibration = delta[self.attitude], delta[self.vibration]
        return RigState(
            state.attitude + attitude if attitude.size else state.attitude,
            state.vibration + vibration if vibration.size else state.vibration,
            state.disparity_px + float(delta[self.disparity].sum()),
            state.focal_ratio + float(delta[self.focal_ratio].sum()),
            state.time_offset_s + float(delta[self.time_offset].sum()),
        )

    @property
    def calibrated(self) -> NDArray[np.int64]:
        """(K,) rows of what the calibration has: attitude, disparity and focal ratio, as far as they are states."""
        return np.r_[self.attitude, self.disparity, self.focal_ratio]

    def calibration(self, state: RigState) -> Array:
        """Return (K,) the mean in the rows `calibrated`."""
        whole = np.array([*state.attitude, state.disparity_px, state.focal_ratio])
        present = [rows.stop > rows.start for rows in (*[self.attitude] * 3, self.disparity, self.focal_ratio)]
        return np.asarray(whole[present])

    def reset_vibration(self, state: RigState) -> RigState:
        """Reset the vibration, which is independent in each frame."""
        return dataclasses.replace(state, vibration=np.zeros(3))

    def rig(self, state: RigState) -> StereoRig:
        """Return the rig corrected by its estimated errors."""
        rig, turned = self._rig, state.attitude + state.vibration
        if turned.any():
            T_body_right = rig.T_body_right @ Pose(so3_exp(turned), np.zeros(3))
            rig = dataclasses.replace(rig, T_body_right=T_body_right)
        if state.disparity_px:
            rig = rig.disparity_shifted(state.disparity_px)
        return rig.right_magnified(state.focal_ratio) if state.focal_ratio else rig

    def at_exposure(self, state: RigState, nav: NavState, turning: Turning) -> NavState:
        """Return the navigation state at the exposure, `time_offset` after the image's stamp.

        Args:
            state: of the rig.
            nav: at the stamp.
            turning: at the stamp.
        """
        if state.time_offset_s == 0.0:
            return nav
        T, dt = nav.T_map_body, state.time_offset_s
        return dataclasses.replace(nav, T_map_body=Pose(so3_exp(turning.rotation(dt)) @ T.R, T.t + nav.v_map * dt))

    def pixel_jacobian(self, rig: StereoRig, points_left: Array) -> Array:
        """Return (N, 4, dim) d(stereo pixels)/d(rig's errors); zero for the time offset.

        Args:
            rig: as `rig` returns it.
            points_left: (N, 3) [m].
        """
        H, first = np.zeros((len(points_left), 4, self.dim)), self.rows.start
        points_right = rig.T_right_left.apply(points_left)
        if self.vibration.stop > first:
            turning = rig.right.project_jacobian(points_right) @ skew(points_right)
            for rows in (self.attitude, self.vibration):
                if rows.stop > rows.start:
                    H[:, 2:, rows.start - first : rows.stop - first] = turning
        if self.has_disparity:
            H[:, 2:, self.disparity.start - first] = rig.disparity_axis
        if self.focal_ratio.stop > self.focal_ratio.start:
            from_centre = rig.right.project(points_right) - rig.right.centre
            H[:, 2:, self.focal_ratio.start - first] = from_centre * (self._rig.right.fx / rig.right.fx)
        return H


def _attitude_covariance(rig: StereoRig, sigma_deg: float, epipolar_sigma_deg: float) -> Array:
    """Return (3, 3) the prior of a rigid rig's attitude: narrow about the axis that changes the disparity."""
    along = np.append(rig.T_right_left.t[:2], 0.0)
    axis = np.cross([0.0, 0.0, 1.0], along / np.linalg.norm(along))
    narrow, wide = np.deg2rad([sigma_deg, max(sigma_deg, epipolar_sigma_deg)]) ** 2
    return np.asarray(wide * np.eye(3) + (narrow - wide) * np.outer(axis, axis))
