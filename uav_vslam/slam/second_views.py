# SPDX-License-Identifier: Apache-2.0
"""Initialises landmarks again with their second view, where images are far apart.

One stereo pair with a small disparity tells the depth of a point roughly, such as to 8 % at 17 px. A view from far away
tells it ten times better, and moves the landmark by more than what was linearised about the first view holds for: the
filter would be over-confident from then on. As long as the pose of the first view is in the state, the landmark is
taken out, and initialised from both views. Nothing is lost: one view of an unknown point says nothing about the pose.
"""

import numpy as np
from numpy.typing import NDArray

from uav_vslam.estimation.filter import Filter
from uav_vslam.estimation.mean import Mean
from uav_vslam.estimation.observation import MIN_DEPTH_M
from uav_vslam.estimation.tracks import Tracks
from uav_vslam.search import rows_of
from uav_vslam.slam.landmark_map import LandmarkMap
from uav_vslam.slam.matches import Matches
from uav_vslam.types import StereoFeatures

Array = NDArray[np.float64]
Ids = NDArray[np.uint32]
Mask = NDArray[np.bool_]
Rows = NDArray[np.intp]

FAR = 0.07  # way between two images over the depth of what they show; 0.04 at 7 Hz, 20 m/s and 70 m
GATE_PROBABILITY = 0.9999  # that both views of a point pass together; as a match they have passed a narrower gate


class SecondViews:
    """Keeps a frame's pose, and where it shows the landmarks added from it, until the next frame."""

    def __init__(self, slam_filter: Filter, landmarks: LandmarkMap) -> None:
        self._filter, self._map = slam_filter, landmarks
        self._last_t_map = slam_filter.nav.T_map_body.t  # [m] at the last frame
        self._ids: Ids = np.zeros(0, np.uint32)
        self._pixels: Array = np.zeros((0, 4))

    def begin(self, features: StereoFeatures) -> None:
        """Keep the pose of a frame, before its update or before landmarks are added, if it is the first or far away."""
        is_kept = len(self._filter.past) > 0 and self._filter.past.stamps_ns[-1] == self._filter.nav.stamp_ns
        if self._filter.can_add_landmarks and not is_kept and self._is_far(features):
            self._filter.keep_pose()

    def add(self, ids: Ids, pixels: Array) -> None:
        """Take over the ascending identifiers of landmarks added from a frame, and its (M, 4) stereo pixels of them."""
        self._ids, self._pixels, self._last_t_map = ids, pixels, self._filter.nav.T_map_body.t

    def among(self, matches: Matches) -> Mask:
        """Return which matches are second views of landmarks, if the poses of both views are in the state."""
        if len(self._filter.past) < 2 or matches.relocalised:
            return np.zeros(len(matches), bool)
        return np.isin(self._map.ids[matches.landmarks], self._ids)

    def update(self, matches: Matches, second: Mask, *, at: Mean, weights: Array) -> Matches:
        """Update with a frame's matches, and return those whose landmarks are kept.

        Args:
            matches: K of them.
            second: (K,) which are second views.
            at: has the poses to linearise at.
            weights: (K,) see `Filter.update`.
        """
        ids, again = self._map.ids[matches.landmarks], matches.landmarks[second]
        points = self._both_views(ids[second], matches.pixels[second])
        self._filter.marginalise(again)
        self._map.move_to_end(again)
        passed = self._filter.update_with_points(
            points,
            rows_of(ids[~second], self._map.ids),
            matches.pixels[~second],
            at=at,
            weights=weights[~second],
            probability=GATE_PROBABILITY,
        )
        self._map.remove(len(self._map) - len(again) + np.flatnonzero(~passed))
        kept = np.isin(ids, self._map.ids)
        return Matches(rows_of(ids[kept], self._map.ids), matches.features[kept], matches.pixels[kept])

    def past_to_drop(self) -> Rows:
        """Return the past poses that the filter need not keep: all but that of the newest frame."""
        return np.flatnonzero(self._filter.past.stamps_ns != self._filter.nav.stamp_ns)

    def _both_views(self, ids: Ids, pixels: Array) -> Tracks:
        """Return landmarks added from the last frame as tracks that end in the newest one, with (M, 4) pixels."""
        first = self._pixels[np.searchsorted(self._ids, ids)]
        return Tracks(np.stack([first, pixels], axis=1), np.ones((len(ids), 2), bool), detected=True)

    def _is_far(self, features: StereoFeatures) -> bool:
        if len(self._map) == 0:
            return True
        depth_m = self._filter.rig.triangulate(features.pixels.astype(float), refinements=0)[:, 2]
        depth_m = depth_m[depth_m > MIN_DEPTH_M]  # not NaN
        way_m = float(np.linalg.norm(self._filter.nav.T_map_body.t - self._last_t_map))
        return len(depth_m) > 0 and way_m > FAR * float(np.median(depth_m))
