# SPDX-License-Identifier: Apache-2.0
"""Where the cameras are in each state, and how exactly they measure."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from uav_vslam.geometry.stereo import StereoRig
from uav_vslam.smoothing.sightings import Rows
from uav_vslam.types import NavState

Array = NDArray[np.float64]

# Of tracked patches, relative to the residuals that remain: found on four rendered flights (leg, seeds 101 to 104) by
# the correlation of the residuals over a track against the true poses, and the white part by the NEES of the motion
# over 14 m (0.9 on average, then). With white noise alone it is 1.3 to 2.8: patches drift with the direction of view.
WHITE = 1.2
OFFSET = 0.37
DRIFT_PER_PX = 0.0057


@dataclass(frozen=True, slots=True)
class PixelNoise:
    """Noise of the observations of one point.

    Attributes:
        white_px: of each pixel coordinate, independent in each frame [px].
        offset_px: of each coordinate of the right image, constant [px].
        drift: of each coordinate of both images, per distance that the image of the point has moved.
    """

    white_px: float
    offset_px: float
    drift: float

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
class Cameras:
    """Where the cameras are.

    Attributes:
        rig: calibration.
        R_left_map: (N, 3, 3), of each state.
        positions: (N, 3) of the body [m].
    """

    rig: StereoRig
    R_left_map: Array
    positions: Array

    def points_left(self, states: Rows, points: Array) -> Array:
        """Return (M, 3) map-frame points [m] in the left camera frames of M states."""
        arms = points - self.positions[states]
        T = self.rig.T_body_left
        return np.einsum("mij,mj->mi", self.R_left_map[states], arms) - T.R.T @ T.t

    def to_map(self, states: Rows, points_left: Array) -> Array:
        """Return (M, 3) points of the left camera frames in the map frame."""
        T = self.rig.T_body_left
        arms = np.einsum("mij,mi->mj", self.R_left_map[states], points_left + T.R.T @ T.t)
        return np.asarray(arms + self.positions[states])

    @staticmethod
    def of(rig: StereoRig, states: Sequence[NavState]) -> "Cameras":
        """Mount a rig on the bodies."""
        R = np.array([state.T_map_body.R for state in states])
        positions = np.array([state.T_map_body.t for state in states])
        return Cameras(rig, rig.T_body_left.R.T @ np.swapaxes(R, 1, 2), positions)
