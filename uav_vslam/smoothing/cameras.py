# SPDX-License-Identifier: Apache-2.0
"""Where the cameras are in each state, how wrong their calibration is, and how exactly they measure."""

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from uav_vslam.config import RigConfig
from uav_vslam.estimation.linearisation import Camera, camera_points, pixel_jacobians
from uav_vslam.estimation.models import MODELS, POSE
from uav_vslam.estimation.observation import MIN_DEPTH_M
from uav_vslam.estimation.rig_belief import with_claims
from uav_vslam.estimation.rig_errors import RigErrors, RigState
from uav_vslam.estimation.turning import Turning
from uav_vslam.geometry.stereo import StereoRig
from uav_vslam.ins.propagation import NAV_DIM
from uav_vslam.smoothing.sightings import Rows
from uav_vslam.types import NavState

Array = NDArray[np.float64]

MODEL = MODELS["so15"]()  # plain differences: every step linearises anew

# Of tracked patches, relative to the residuals that remain: found on four rendered flights (leg, seeds 101 to 104) by
# the correlation of the residuals over a track against the true poses, and the white part by the NEES of the motion
# over 14 m (1.1 on average, then). With white noise alone it is 1.3 to 2.8: patches drift with the direction of view.
WHITE = 1.3
OFFSET = 0.40
DRIFT_PER_PX = 0.0062


@dataclass(frozen=True, slots=True)
class PixelNoise:
    """Noise of the observations of one point.

    Attributes:
        white_px: of each raw pixel coordinate, independent in each frame [px].
        offset_px: of each coordinate of the raw right image, constant [px].
        drift: of each coordinate of both images, per distance that the image of the point has moved.
        cut: length of the normalised residual beyond which an observation is wrong and does not count.
    """

    white_px: float
    offset_px: float
    drift: float
    cut: float = np.inf

    @staticmethod
    def of_tracks(residual_px: float) -> "PixelNoise":
        """Return the noise of patches that are tracked, by their typical residual [px]."""
        return PixelNoise(WHITE * residual_px, OFFSET * residual_px, DRIFT_PER_PX * residual_px)

    @staticmethod
    def of_detections(residual_px: float) -> "PixelNoise":
        """Return the noise of points that are detected afresh in each frame: white."""
        return PixelNoise(residual_px, 1e-6 * residual_px, 1e-9 * residual_px)

    @property
    def prior_information(self) -> Array:
        """(4,) inverse variances of the right image's offset and of the drift."""
        return np.repeat([self.offset_px**-2.0, self.drift**-2.0], 2)


@dataclass(frozen=True, slots=True)
class Observed:
    """Predicted stereo pixels and their Jacobians.

    Attributes:
        expected: (M, 4) [px].
        by_pose: (M, 4, 6 or 9): position, attitude, and the vibration if the rig flexes.
        by_point: (M, 4, 3).
        by_rig: (M, 4, dim): constant errors of the rig.
    """

    expected: Array
    by_pose: Array
    by_point: Array
    by_rig: Array


@dataclass(frozen=True, slots=True)
class RigEstimate:
    """How wrong the rig's calibration is.

    Attributes:
        errors: layout and priors, as the filter has them.
        constant: (dim,) error of the whole flight; what drifts slowly in the filter is constant here.
        vibration: (N, 3) rotation vectors of the right camera in each state, zero unless the rig flexes [rad].
    """

    errors: RigErrors
    constant: Array
    vibration: Array

    @staticmethod
    def of(rig: StereoRig, config: RigConfig, states: int) -> "RigEstimate":
        """Trust the calibration, at first."""
        errors = RigErrors(rig, config, NAV_DIM)
        return RigEstimate(errors, np.zeros(errors.dim), np.zeros((states, 3)))

    @property
    def vibrates(self) -> bool:
        """Whether the rig flexes."""
        return self.errors.has_vibration

    @property
    def lasting(self) -> Array:
        """(dim,) 1 for constant errors, 0 for the vibration."""
        lasting = np.ones(NAV_DIM + self.errors.dim)
        lasting[self.errors.vibration] = 0.0
        return lasting[NAV_DIM:]

    def moved(self, constant: Array, vibration: Array) -> "RigEstimate":
        """Return the estimate after corrections (dim,) and (N, 0 or 3)."""
        return dataclasses.replace(
            self,
            constant=self.constant + constant,
            vibration=self.vibration + vibration if self.vibrates else self.vibration,
        )

    def judged(self, covariance: Array) -> "RigEstimate":
        """Exchange the prior of the disparity's error, as the filter does, given the (dim, dim) covariance."""
        if not self.errors.has_disparity:
            return self
        row, prior = self.errors.disparity.start - NAV_DIM, self.errors.disparity_variance
        mean, variance = float(self.constant[row]), float(covariance[row, row])
        now = self.errors.disparity_prior.given(mean, variance, prior=prior)[1]
        return dataclasses.replace(self, errors=self.errors.with_disparity_variance(now))

    def claimed(self, covariance: Array) -> Array:
        """Return the (m, m) covariance of the constant errors and others with the uncertainty of the calibration."""
        if not self.errors.has_disparity:
            return covariance
        row = self.errors.disparity.start - NAV_DIM
        return with_claims(covariance, row, self.errors, float(self.constant[row]))

    def state(self, row: int) -> RigState:
        """Return the rig's state in one state of the flight."""
        delta = np.concatenate([np.zeros(NAV_DIM), self.lasting * self.constant])
        if self.vibrates:
            delta[self.errors.vibration] = self.vibration[row]
        return self.errors.retract(RigState(), delta)


class Cameras:
    """The cameras of all states of a flight."""

    def __init__(self, states: Sequence[NavState], turnings: Sequence[Turning], rig: RigEstimate) -> None:
        """Mount the cameras on (N,) states, with what is known of their rotation."""
        self._lasting = rig.lasting
        self._vibration = rig.errors.vibration
        at = [rig.state(row) for row in (range(len(states)) if rig.vibrates else [0])]
        rigs = [rig.errors.rig(state) for state in at]
        self._cameras = [
            Camera(
                rig=rigs[k % len(rigs)],
                errors=rig.errors,
                model=MODEL,
                nav=rig.errors.at_exposure(at[k % len(at)], state, turning),
                rate_map=turning.rate(at[k % len(at)].time_offset_s),
                sigma_px=1.0,
                depth_sigma_ratio=0.0,
            )
            for k, (state, turning) in enumerate(zip(states, turnings, strict=True))
        ]
        T_map_left = [camera.nav.T_map_body @ camera.rig.T_body_left for camera in self._cameras]
        self._R_map_left = np.array([T.R for T in T_map_left])
        self._origins = np.array([T.t for T in T_map_left])

    @property
    def rig(self) -> StereoRig:
        """The rig in the first state."""
        return self._cameras[0].rig

    def points_left(self, states: Rows, points: Array) -> Array:
        """Return (M, 3) map-frame points [m] in the left camera frames of M states."""
        return np.einsum("mij,mi->mj", self._R_map_left[states], points - self._origins[states])

    def to_map(self, states: Rows, points_left: Array) -> Array:
        """Return (M, 3) points of the left camera frames in the map frame."""
        return np.asarray(np.einsum("mij,mj->mi", self._R_map_left[states], points_left) + self._origins[states])

    def observe(self, states: Rows, points: Array) -> Observed:
        """Predict the stereo pixels of (M, 3) points, each in one of M states, with Jacobians."""
        count = len(states)
        vibration = self._vibration.stop - self._vibration.start
        expected, by_point = np.empty((count, 4)), np.empty((count, 4, 3))
        by_pose, by_rig = np.empty((count, 4, 6 + vibration)), np.empty((count, 4, len(self._lasting)))
        if count == 0:
            return Observed(expected, by_pose, by_point, by_rig)
        order = np.argsort(states, kind="stable")
        present, first = np.unique(states[order], return_index=True)
        for state, start, end in zip(present.tolist(), first, np.append(first[1:], count), strict=True):
            camera, rows = self._cameras[state], order[start:end]
            c, J_vehicle, J_point = camera_points(camera, points[rows])
            c[:, 2] = np.maximum(c[:, 2], MIN_DEPTH_M)  # a point that slips behind the camera is an outlier
            H, by_point[rows] = pixel_jacobians(camera, c, c, J_vehicle, J_point)
            expected[rows] = camera.rig.project(c)
            by_pose[rows, :, :6], by_pose[rows, :, 6:] = H[:, :, POSE], H[:, :, self._vibration]
            by_rig[rows] = H[:, :, NAV_DIM:] * self._lasting
        return Observed(expected, by_pose, by_point, by_rig)
