# SPDX-License-Identifier: Apache-2.0
"""Relocalisation: the pose from matched landmarks alone, when the prediction is too uncertain for gating."""

import numpy as np
from numpy.typing import NDArray

from uav_vslam.config import BackendConfig
from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.stereo import StereoRig
from uav_vslam.types import StereoFeatures
from uav_vslam.vision.matching.nn_ratio import match_descriptors
from uav_vslam.vision.pnp import pnp_ransac

Array = NDArray[np.float64]


def locate(
    rig: StereoRig,
    T_map_body: Pose,
    points_map: Array,
    pixels: NDArray[np.float32],
    *,
    threshold_px: float,
    min_inliers: int,
) -> tuple[Pose, NDArray[np.intp]] | None:
    """Return T_map_body and its inlier rows by PnP with RANSAC; None with fewer than min_inliers.

    Args:
        rig: calibration.
        T_map_body: predicted pose, the initial value.
        points_map: (N, 3) matched landmarks [m].
        pixels: (N, 4) their stereo pixels.
        threshold_px: reprojection error of an inlier.
        min_inliers: least number of inliers.
    """
    T_map_left = T_map_body @ rig.T_body_left
    solved = pnp_ransac(points_map, pixels[:, :2].astype(float), rig.left, T_map_left, threshold_px=threshold_px)
    if solved is None:
        return None
    T_map_left, inliers = solved
    if int(inliers.sum()) < min_inliers:
        return None
    return T_map_left @ rig.T_body_left.inverse(), np.flatnonzero(inliers)


def relocalise(
    rig: StereoRig,
    T_map_body: Pose,
    landmarks: Array,
    landmark_descriptors: NDArray[np.uint8],
    features: StereoFeatures,
    *,
    config: BackendConfig,
) -> tuple[Pose, NDArray[np.intp], NDArray[np.intp]] | None:
    """Match all landmarks by descriptor alone and verify by PnP.

    Returns:
        T_map_body, landmark rows and feature rows; None with too few inliers.
    """
    matches = match_descriptors(landmark_descriptors, features.descriptors, config.min_descriptor_ratio)
    found = locate(
        rig,
        T_map_body,
        landmarks[matches[:, 0]],
        features.pixels[matches[:, 1]],
        threshold_px=config.pnp_px,
        min_inliers=config.min_relocalisation_inliers,
    )
    if found is None:
        return None
    pose, inliers = found
    return pose, matches[inliers, 0], matches[inliers, 1]
