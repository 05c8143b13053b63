# SPDX-License-Identifier: Apache-2.0
"""Loop closure: recognises groups of landmarks that are in view again after a long absence.

The drift since then makes each gate wide, with ambiguous candidates inside. But the drift is common to all: given one
correct match, the joint covariance makes the other gates narrow. So matches are accepted only as a jointly compatible
group [neira01], never alone.
"""

import numpy as np
from numpy.typing import NDArray

from uav_vslam.association.consensus import consensus
from uav_vslam.association.guided import associate
from uav_vslam.config import BackendConfig
from uav_vslam.estimation.filter import Filter
from uav_vslam.slam.landmark_map import LandmarkMap
from uav_vslam.types import StereoFeatures

Rows = NDArray[np.intp]


def recognise(
    slam_filter: Filter, landmark_map: LandmarkMap, features: StereoFeatures, rows: Rows, *, config: BackendConfig
) -> Rows:
    """Return (K, 2) pairs (landmark row, feature row) that are jointly compatible; none if too few are.

    Args:
        slam_filter: predicted to the frame.
        landmark_map: the landmarks' descriptors.
        features: of the frame.
        rows: projectable landmarks to be recognised; each may match any feature.
        config: gate, ratio, and the least group size.
    """
    none = np.zeros((0, 2), np.intp)
    if len(rows) < config.min_revisited:
        return none
    predicted, pixels = slam_filter.predict_observations(rows), features.pixels.astype(float)
    found = associate(
        predicted.expected,
        predicted.innovation_covariance(),
        landmark_map.descriptors[rows],
        pixels,
        features.descriptors,
        probability=config.gate_probability,
        ratio=config.min_descriptor_ratio,
    )
    if len(found) < config.min_revisited:
        return none
    nu, S = slam_filter.joint_innovation(rows[found[:, 0]], pixels[found[:, 1]])
    S = S + config.redetection_px**2 * np.eye(len(S))
    agreeing = found[consensus(nu, S, probability=config.gate_probability)]
    if len(agreeing) < config.min_revisited:
        return none
    return np.column_stack([rows[agreeing[:, 0]], agreeing[:, 1]])
