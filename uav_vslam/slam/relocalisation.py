# SPDX-License-Identifier: Apache-2.0
"""Relocalisation: the pose from matched landmarks alone, when the prediction is too uncertain for gating."""

import dataclasses

import numpy as np
from numpy.typing import NDArray

from uav_vslam.config import BackendConfig
from uav_vslam.estimation.filter import Filter
from uav_vslam.slam.matches import Matches
from uav_vslam.types import StereoFeatures
from uav_vslam.vision.matching.nn_ratio import match_descriptors
from uav_vslam.vision.pnp import pnp_ransac

MIN_INLIERS = 12  # fewer, and the vehicle coasts on its INS
ITERATE_BEYOND_M = 0.05  # PnP and INS differ by more: the update is linearised at the PnP pose


def verified(slam_filter: Filter, matches: Matches, config: BackendConfig, *, min_inliers: int) -> Matches | None:
    """Keep the inliers of PnP with RANSAC; None with fewer than `min_inliers`.

    If the pose found is far from the predicted one, it becomes the linearisation point.
    """
    rig, predicted = slam_filter.rig, slam_filter.nav.T_map_body
    solved = pnp_ransac(
        slam_filter.landmarks[matches.landmarks],
        matches.pixels[:, :2],
        rig.left,
        predicted @ rig.T_body_left,
        threshold_px=config.pnp_px,
    )
    if solved is None or int(solved[1].sum()) < min_inliers:
        return None
    T_map_left, inliers = solved
    T_map_body = T_map_left @ rig.T_body_left.inverse()
    is_far = np.linalg.norm(T_map_body.t - predicted.t) > ITERATE_BEYOND_M
    agreeing = matches.chosen(np.flatnonzero(inliers))
    return dataclasses.replace(agreeing, linearise_at=T_map_body if is_far else None)


def relocalise(
    slam_filter: Filter, landmark_descriptors: NDArray[np.uint8], features: StereoFeatures, config: BackendConfig
) -> Matches | None:
    """Match all landmarks by descriptor alone and verify by PnP; None with too few inliers."""
    pairs = match_descriptors(landmark_descriptors, features.descriptors, config.min_descriptor_ratio)
    matches = Matches.of(pairs, features, relocalised=True)
    return verified(slam_filter, matches, config, min_inliers=MIN_INLIERS)
