# SPDX-License-Identifier: Apache-2.0
"""Loop closure: recognises groups of landmarks that are in view again after a long absence.

The drift since then makes each gate wide, with ambiguous candidates inside. But the drift is common to all: given one
correct match, the joint covariance makes the other gates narrow. So matches are accepted only as a jointly compatible
group [neira01], never alone, and only if wrong ones are unlikely to agree so well by chance [moisan04]: in look-alike
places two of some candidates do, where the drift is hardly larger than the landmarks' own uncertainty.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.special import bdtrc

from uav_vslam.association.consensus import consensus
from uav_vslam.association.guided import gated
from uav_vslam.config import BackendConfig
from uav_vslam.estimation.filter import Filter
from uav_vslam.geometry.stereo import STEREO_DOF
from uav_vslam.slam.landmark_map import LandmarkMap
from uav_vslam.types import StereoFeatures

Array = NDArray[np.float64]
Rows = NDArray[np.intp]

MIN_GROUP = 2  # one match agrees with itself


def recognise(
    slam_filter: Filter, landmark_map: LandmarkMap, features: StereoFeatures, rows: Rows, *, config: BackendConfig
) -> Rows:
    """Return (K, 2) pairs (landmark row, feature row) that are jointly compatible, and hardly by chance.

    Args:
        slam_filter: predicted to the frame.
        landmark_map: the landmarks' descriptors.
        features: of the frame.
        rows: projectable landmarks to be recognised; each may match any feature.
        config: gate, ratio, and how many groups may be expected by chance.
    """
    none = np.zeros((0, 2), np.intp)
    if len(rows) < MIN_GROUP:
        return none
    predicted = slam_filter.predict_observations(rows)
    in_view = landmark_map.in_view(rows, predicted.expected, predicted.innovation_covariance())
    found = gated(in_view, features, config)
    if len(found) < MIN_GROUP:
        return none
    nu, S = slam_filter.joint_innovation(rows[found[:, 0]], features.pixels[found[:, 1]].astype(float))
    S = S + config.redetection_px**2 * np.eye(len(S))
    agreeing = consensus(nu, S, probability=config.gate_probability)
    if len(agreeing) < MIN_GROUP or expected_by_chance(S, agreeing) > config.chance_revisits:
        return none
    return np.column_stack([rows[found[agreeing, 0]], found[agreeing, 1]])


def expected_by_chance(S: Array, agreeing: Rows) -> float:
    """Return a bound on how many such groups are expected among wrong matches, anywhere in their gates: `n P(K >= k)`.

    Each of the n matches is tried as the one that conditions the others' gates. A wrong match is then inside with the
    ratio of the two gates' volumes, so the number of those that are is binomial [moisan04].

    Args:
        S: (4n, 4n) joint innovation covariance of all matches tried [px^2].
        agreeing: (k,) those of the group, two at least.
    """
    tried = len(S) // STEREO_DOF
    coordinates = STEREO_DOF * agreeing[:, None] + np.arange(STEREO_DOF)
    first, second = np.triu_indices(len(agreeing), 1)
    volumes = _volumes(S, coordinates)
    shares = _volumes(S, np.hstack([coordinates[first], coordinates[second]])) / (volumes[first] * volumes[second])
    return float(tried * bdtrc(len(agreeing) - 2, tried - 1, shares.mean()))


def _volumes(S: Array, coordinates: Rows) -> Array:
    """Return (P,) volumes of gates of some coordinates (P, d) each, over that of a unit ball."""
    return np.sqrt(np.linalg.det(S[coordinates[:, :, None], coordinates[:, None, :]]))
