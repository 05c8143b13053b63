# SPDX-License-Identifier: Apache-2.0
"""Stereo gate: left and right pixels must satisfy the epipolar constraint at a possible depth.

Any rig will do: the baseline may be along the image's vertical and the cameras may converge. If the rig flexes, points
are off the calibrated epipolar line, and the gate is wider by the configured uncertainty.
"""

import math

import numpy as np
from numpy.typing import NDArray

from uav_vslam.config import FrontendConfig, RigConfig
from uav_vslam.geometry.stereo import StereoRig
from uav_vslam.vision.disparity_filter import supported_disparities

Array = NDArray[np.float64]

SIGMAS = 3.0  # of the right camera's attitude; with two, one frame in twenty would lose its matches


class StereoGate:
    """Gate for stereo matches from any matcher.

    Attributes:
        epipolar_px: largest distance of the right point from the left point's epipolar line [raw px].
    """

    def __init__(self, rig: StereoRig, config: FrontendConfig, rig_config: RigConfig, *, noise_px: float) -> None:
        """Prepare for one rig.

        Args:
            rig: calibration.
            config: range of depths and the gate of a rigid rig.
            rig_config: uncertainty of the calibration.
            noise_px: largest difference of two disparities on one surface due to noise [px].
        """
        self._rig, self._rig_config, self._noise_px = rig, rig_config, noise_px
        self.configure(config)

    def configure(self, config: FrontendConfig) -> None:
        """Judge by other gates from now on."""
        self._config = config
        self.epipolar_px = epipolar_gate(self._rig, config.epipolar_px, self._rig_config)

    def check(self, pixels: Array) -> tuple[Array, NDArray[np.bool_]]:
        """Return the (N,) depths [m] of (N, 4) undistorted stereo pixels, and the mask of valid matches.

        Valid ones are on their epipolar lines, at a possible depth, and have a disparity supported by their neighbours.
        Noise alone must not make a depth impossible: without those that it moves too far, the others are too near.
        """
        depth = self._rig.triangulate(pixels)[:, 2]
        focal_baseline = self._rig.left.fx * self._rig.baseline_m
        least_px = focal_baseline / self._config.max_depth_m - 0.5 * self._noise_px
        good = self._rig.epipolar_distance(pixels) <= self.epipolar_px
        good &= (depth >= self._config.min_depth_m) & (focal_baseline >= least_px * depth)  # NaN compares as False
        disparity = focal_baseline / depth[good]
        good[good] = supported_disparities(pixels[good, :2], disparity, noise_px=self._noise_px)
        return depth, good


def epipolar_gate(rig: StereoRig, epipolar_px: float, rig_config: RigConfig) -> float:
    """Return the gate's distance from the epipolar line [px], which is `epipolar_px` for a rigid rig.

    0.05 degrees of slow error and 0.05 of vibration move a point by 2 px, one sigma, at a focal length of 1642 px.
    """
    if not rig_config.flexing:
        return epipolar_px
    sigma_deg = math.hypot(rig_config.attitude_sigma_deg, rig_config.vibration_sigma_deg)
    return epipolar_px + SIGMAS * math.radians(sigma_deg) * max(rig.right.fx, rig.right.fy)


def stereo_candidates(
    left: Array, right: Array, rig: StereoRig, *, epipolar_px: float, depth_range_m: tuple[float, float]
) -> NDArray[np.bool_]:
    """Return the pairs allowed by stereo geometry.

    Args:
        left, right: (Na, 2), (Nb, 2) undistorted pixels.
        rig: calibration.
        epipolar_px: largest distance of the right point from the left point's epipolar line [undistorted px]. Near the
            edge of a wide lens that is stricter than the gate's raw ones: descriptors are mistaken more often there.
        depth_range_m: smallest and largest depth in the left camera [m].

    Returns:
        (Na, Nb) mask.
    """
    allowed = epipolar_distances(left, right, rig) <= epipolar_px
    rows, columns = np.nonzero(allowed)
    depth = rig.triangulate(np.hstack([left[rows], right[columns]]))[:, 2]
    near, far = depth_range_m
    possible = (depth >= near) & (depth <= far)  # NaN compares as False
    allowed[rows[~possible], columns[~possible]] = False
    return allowed


def epipolar_distances(left: Array, right: Array, rig: StereoRig) -> Array:
    """Return (Na, Nb) distances [undistorted px] of all right pixels from the epipolar lines of all left pixels."""
    lines = np.hstack([left, np.ones((len(left), 1))]) @ rig.fundamental.T
    norm = np.linalg.norm(lines[:, :2], axis=1, keepdims=True)
    lines = lines / np.where(norm > 0, norm, 1.0)
    return np.asarray(np.abs(lines @ np.hstack([right, np.ones((len(right), 1))]).T))
