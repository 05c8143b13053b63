# SPDX-License-Identifier: Apache-2.0
"""Landmarks that come back into view after a long absence: recognising a group of them closes a loop.

By then the vehicle has drifted, so each of them may be anywhere in a wide gate, where other points look alike. But the
drift is common to all: given one right match, the joint covariance makes the others' gates narrow. So they are believed
only together, as the joint compatibility of [neira01] demands, and one that stands alone is not used.
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
    belief: Filter, landmark_map: LandmarkMap, features: StereoFeatures, rows: Rows, *, config: BackendConfig
) -> Rows:
    """Return (K, 2) pairs (landmark row, feature row) that agree with one another; none where too few do.

    Args:
        belief: predicted to the frame.
        landmark_map: looks of the landmarks.
        features: of the frame.
        rows: projectable landmarks that are to be recognised; each of them may claim any feature.
        config: gate, ratio, and how many must agree.
    """
    none = np.zeros((0, 2), np.intp)
    if len(rows) < config.min_revisited:
        return none
    predicted, pixels = belief.predict_observations(rows), features.pixels.astype(float)
    found = associate(
        predicted.expected,
        predicted.S,
        landmark_map.descriptors[rows],
        pixels,
        features.descriptors,
        probability=config.gate_probability,
        ratio=config.min_descriptor_ratio,
    )
    if len(found) < config.min_revisited:
        return none
    nu, S = belief.joint_innovation(rows[found[:, 0]], pixels[found[:, 1]])
    S = S + config.redetection_px**2 * np.eye(len(S))
    agreeing = found[consensus(nu, S, probability=config.gate_probability)]
    if len(agreeing) < config.min_revisited:
        return none
    return np.column_stack([rows[agreeing[:, 0]], agreeing[:, 1]])
