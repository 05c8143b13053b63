# SPDX-License-Identifier: Apache-2.0
"""Where in a saved map a stereo frame was taken: descriptors, PnP, then a fit that weighs each landmark's own error.

A frame is located in one section alone, because the errors of two are correlated to an unknown degree. With z_i the
stereo pixels of landmark l_i, S_i = H_i (D_i + f^2 I) H_i^T + sigma_px^2 I and f the distance between two detections of
one place, the pose T minimises sum |z_i - h(T, l_i)|^2 over S_i. The section's common error moves all landmarks, and so
the pose, rigidly: its covariance, moved to the vehicle, adds to that of the fit.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from uav_vslam.config import VehicleConfig
from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.rotation import skew
from uav_vslam.geometry.stereo import STEREO_DOF, StereoRig
from uav_vslam.numerics import inverse_spd, mahalanobis2, symmetrise
from uav_vslam.slam.saved_map.record import MapSection, SavedMap
from uav_vslam.types import StereoFeatures
from uav_vslam.vision.matching.nn_ratio import match_descriptors
from uav_vslam.vision.pnp import pnp_ransac

Array = NDArray[np.float64]
Rows = NDArray[np.intp]

MIN_INLIERS = 8  # landmarks that must fit one pose: so many wrong matches of some dozens do not by chance
TRIED_SECTIONS = 6  # those with most matches
WIDER_PNP = 2.5  # of `backend.pnp_px`: landmarks err by decimetres of their own, which the fit weighs and PnP does not
STEPS = 8  # of Gauss-Newton, each with a new choice of inliers
GATE_PROBABILITY = 0.999
MIN_DEPTH_M = 0.1


@dataclass(frozen=True, slots=True)
class Located:
    """A pose in the map.

    Attributes:
        T_map_body: pose.
        covariance: (6, 6) of position and rotation (map-frame rotation vector), the map's errors included.
        section: of the map.
        pairs: (M, 2) rows of the section's landmarks that fit, and of the frame's features.
    """

    T_map_body: Pose
    covariance: Array
    section: MapSection
    pairs: Rows

    @property
    def inliers(self) -> int:
        """Landmarks that fit."""
        return len(self.pairs)


class MapLocator:
    """Locates frames in one map.

    Attributes:
        reason: why the last frame could not be located; empty if it was.
    """

    def __init__(self, saved: SavedMap, rig: StereoRig, config: VehicleConfig) -> None:
        self._saved, self._rig = saved, rig
        self.configure(config)
        self.reason = ""

    def configure(self, config: VehicleConfig) -> None:
        """Go on with live settings that have changed."""
        self._ratio, self._threshold_px = config.backend.min_descriptor_ratio, WIDER_PNP * config.backend.pnp_px
        self._sigma_px, self._floor_m = config.backend.sigma_px, config.fusion.floor_sigma_m

    def locate(self, features: StereoFeatures) -> Located | None:
        """Return where a frame was taken; None if no section has enough landmarks that fit."""
        pixels = features.pixels.astype(float)
        matched = [(section, self._matches(section, features)) for section in self._saved.sections]
        matched.sort(key=lambda found: -len(found[1]))
        fits = [self._fit(section, pixels, pairs) for section, pairs in matched[:TRIED_SECTIONS]]
        best = max((fit for fit in fits if fit is not None), key=lambda fit: fit.inliers, default=None)
        self.reason = ""
        if best is None:
            most = len(matched[0][1]) if matched else 0
            self.reason = (
                f"of {len(features)} points at most {most} resemble landmarks of one section of the map, "
                f"and fewer than {MIN_INLIERS} of them fit one pose"
            )
        return best

    def _matches(self, section: MapSection, features: StereoFeatures) -> Rows:
        if len(features) == 0 or features.descriptors.shape[1] != section.descriptors.shape[1]:
            return np.zeros((0, 2), np.intp)
        return match_descriptors(section.descriptors, features.descriptors, self._ratio)

    def _fit(self, section: MapSection, pixels: Array, pairs: Rows) -> Located | None:
        if len(pairs) < MIN_INLIERS:
            return None
        rows, z = pairs[:, 0], pixels[pairs[:, 1]]
        solved = pnp_ransac(section.positions[rows], z[:, :2], self._rig.left, threshold_px=self._threshold_px)
        if solved is None or int(solved[1].sum()) < MIN_INLIERS:
            return None
        T, inliers = solved[0] @ self._rig.T_body_left.inverse(), solved[1]
        D = section.own_covariances[rows] + self._floor_m**2 * np.eye(3)
        for _ in range(STEPS):
            nu, H, S = _linearised(self._rig, T, section.positions[rows], D, z, self._sigma_px)
            HtW = np.swapaxes(H[inliers], 1, 2) @ np.linalg.inv(S[inliers])
            P = inverse_spd(symmetrise((HtW @ H[inliers]).sum(axis=0)), "pose in the map")
            step = P @ np.einsum("nij,nj->i", HtW, nu[inliers])
            T = T.moved(step)
            inliers = mahalanobis2(nu, S) <= chdtri(STEREO_DOF, 1.0 - GATE_PROBABILITY)
            if inliers.sum() < MIN_INLIERS:
                return None
        return Located(T, symmetrise(P + section.common_covariance(T.t)), section, pairs[inliers])


def _linearised(
    rig: StereoRig, T_map_body: Pose, points: Array, D: Array, z: Array, sigma_px: float
) -> tuple[Array, Array, Array]:
    """Return innovations (N, 4), Jacobians by position and rotation (N, 4, 6) and covariances S (N, 4, 4) [px]."""
    arm = points - T_map_body.t
    R_left_map = rig.T_body_left.R.T @ T_map_body.R.T
    left = (arm @ T_map_body.R - rig.T_body_left.t) @ rig.T_body_left.R
    left[:, 2] = np.maximum(left[:, 2], MIN_DEPTH_M)
    H_point = rig.project_jacobian(left) @ R_left_map
    H = np.concatenate([-H_point, H_point @ skew(arm)], axis=2)
    noise_px = sigma_px * rig.magnification(z)[:, None, None]
    S = H_point @ D @ np.swapaxes(H_point, 1, 2) + noise_px**2 * np.eye(STEREO_DOF)
    return z - rig.project(left), H, symmetrise(S)
