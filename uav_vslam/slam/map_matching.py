# SPDX-License-Identifier: Apache-2.0
"""Data association of a frame with the map: sets of matches to try, the cheapest first.

1. all matches of the configured associator; the default one searches the gates of the prediction,
2. those of them that are PnP inliers,
3. those of them that are jointly consistent,
4. matches in the whole map without a gate, confirmed by PnP.

Steps 2 and 3 use the matches of step 1, not the frame's features.
"""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from uav_vslam.association import ASSOCIATORS, Associator
from uav_vslam.association.consensus import consensus
from uav_vslam.config import BackendConfig
from uav_vslam.estimation.filter import Filter
from uav_vslam.estimation.observation import projectable
from uav_vslam.geometry.image_grid import spread
from uav_vslam.slam.known_tracks import tracks_first
from uav_vslam.slam.landmark_map import LandmarkMap
from uav_vslam.slam.matches import Matches
from uav_vslam.slam.relocalisation import relocalise, verified
from uav_vslam.slam.revisits import recognise
from uav_vslam.types import StereoFeatures

Rows = NDArray[np.intp]

MIN_INLIERS = 6  # of PnP; with fewer the frame is matched with the whole map, without gates
VIEW_MARGIN_PX = 50.0  # a landmark predicted so far outside the image may still be seen


class MapMatcher:
    """Matches one frame after another against a filter's map."""

    def __init__(self, config: BackendConfig, associate: Associator | None = None) -> None:
        """Match with the configured associator, or with the given one instead."""
        self._config = config
        self._associate = associate or ASSOCIATORS[config.association]

    def configure(self, config: BackendConfig) -> None:
        """Apply changed live settings."""
        self._config = config

    def candidates(
        self, slam_filter: Filter, landmark_map: LandmarkMap, features: StereoFeatures, frame: int, *, located: bool
    ) -> Iterator[Matches]:
        """Yield sets of matches to try in turn.

        Args:
            slam_filter: predicted to the frame.
            landmark_map: descriptors and history of its landmarks.
            features: of the frame.
            frame: its number.
            located: by tracks, so that a few landmarks in their gates are enough, and a search of the map needless.
        """
        if len(landmark_map) == 0 or len(features) == 0:
            return
        gated, uncertain = self._gated(slam_filter, landmark_map, features, frame)
        if located or (not uncertain and len(gated) >= MIN_INLIERS):
            yield self._capped(slam_filter, landmark_map, gated)
        if located:
            return
        attempts = (
            lambda: verified(slam_filter, gated, self._config, min_inliers=MIN_INLIERS),
            lambda: self._agreeing(slam_filter, self._capped(slam_filter, landmark_map, gated)),
            lambda: relocalise(slam_filter, landmark_map.descriptors, features, self._config),
        )
        for attempt in attempts:  # each runs only after the previous one was rejected
            found = attempt()
            if found is not None:
                yield self._capped(slam_filter, landmark_map, found)

    def _gated(
        self, slam_filter: Filter, landmark_map: LandmarkMap, features: StereoFeatures, frame: int
    ) -> tuple[Matches, bool]:
        """Return the gated matches, and whether the prediction was too uncertain to rely on the gate alone.

        Landmarks revisited with a wide gate are matched first, and jointly: a similar feature has often been added
        as another landmark before the revisit was accepted.
        """
        rows = np.flatnonzero(projectable(slam_filter.rig, slam_filter.points_left(), margin_px=VIEW_MARGIN_PX))
        if len(rows) == 0:
            return Matches.none(), True
        predicted = slam_filter.predict_observations(rows)
        S = predicted.innovation_covariance()
        sigma_px = np.sqrt(np.trace(S, axis1=1, axis2=2) / 4.0)
        uncertain = bool(np.median(sigma_px) > self._config.pnp_beyond_px)
        back = landmark_map.long_unseen(frame)[rows] & (sigma_px > self._config.pnp_beyond_px)
        revisited = recognise(slam_filter, landmark_map, features, rows[back], config=self._config)
        free = np.delete(np.arange(len(features)), revisited[:, 1])
        others = rows[~back]
        in_view = landmark_map.in_view(others, predicted.expected[~back], S[~back])
        matches = tracks_first(
            self._associate, in_view, landmark_map.tracks[others], features.chosen(free), self._config
        )
        pairs = np.vstack([revisited, np.column_stack([others[matches[:, 0]], free[matches[:, 1]]])])
        return Matches.of(pairs, features), uncertain

    def _agreeing(self, slam_filter: Filter, matches: Matches) -> Matches | None:
        """Return the largest jointly consistent set of matches; None if it is too small."""
        nu, S = slam_filter.joint_innovation(matches.landmarks, matches.pixels)
        rows = consensus(nu, S, probability=self._config.gate_probability)
        return matches.chosen(rows) if len(rows) >= MIN_INLIERS else None

    def _capped(self, slam_filter: Filter, landmark_map: LandmarkMap, matches: Matches) -> Matches:
        """Cap the number of updates, oldest landmarks first, spread over the image."""
        order = np.argsort(landmark_map.born[matches.landmarks], kind="stable")
        pixels, size = matches.pixels[order, :2], slam_filter.rig.left.size
        return matches.chosen(order[spread(pixels, self._config.max_observations, size=size)])
