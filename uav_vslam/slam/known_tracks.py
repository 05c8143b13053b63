# SPDX-License-Identifier: Apache-2.0
"""Data association by the front end's track number, without comparing descriptors."""

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from uav_vslam.association import Associator, InView
from uav_vslam.config import BackendConfig
from uav_vslam.geometry.stereo import STEREO_DOF
from uav_vslam.numerics import mahalanobis2
from uav_vslam.types import StereoFeatures

Rows = NDArray[np.intp]
Tracks = NDArray[np.uint32]


def tracks_first(
    associate: Associator, landmark_map: InView, tracks: Tracks, seen: StereoFeatures, config: BackendConfig
) -> Rows:
    """Return (K, 2) pairs (row in `landmark_map`, row in `seen`): those with equal track, then an associator's.

    Args:
        associate: gets only what has no equal track.
        landmark_map: N landmarks that may be in view.
        tracks: (N,) track that last observed each, 0 for none.
        seen: features of the frame.
        config: of the back end.
    """
    known = followed(landmark_map, tracks, seen, probability=config.gate_probability)
    if len(known) == 0:
        return associate(landmark_map, seen, config)
    other_landmarks = np.delete(np.arange(len(landmark_map)), known[:, 0])
    other_seen = np.delete(np.arange(len(seen)), known[:, 1])
    more = associate(landmark_map.chosen(other_landmarks), seen.chosen(other_seen), config)
    return np.vstack([known, np.column_stack([other_landmarks[more[:, 0]], other_seen[more[:, 1]]])])


def followed(landmark_map: InView, tracks: Tracks, seen: StereoFeatures, *, probability: float) -> Rows:
    """Return (K, 2) pairs with equal track whose feature is in the landmark's gate; see `tracks_first`."""
    _, rows, features = np.intersect1d(tracks, seen.tracks, return_indices=True)
    known = tracks[rows] != 0
    rows, features = rows[known], features[known]
    nu = seen.pixels[features] - landmark_map.expected[rows]
    inside = mahalanobis2(nu, landmark_map.S[rows]) <= chdtri(STEREO_DOF, 1.0 - probability)
    return np.column_stack([rows[inside], features[inside]])
