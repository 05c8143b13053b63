# SPDX-License-Identifier: Apache-2.0
"""The landmarks in a filter's state, frame by frame: they correct it, new ones are added, and some leave it again."""

import copy

import numpy as np
from numpy.typing import NDArray

from uav_vslam.config import BackendConfig
from uav_vslam.estimation.filter import Filter
from uav_vslam.estimation.observation import projectable
from uav_vslam.estimation.weighted_update import Innovation
from uav_vslam.geometry.image_grid import spread
from uav_vslam.slam.landmark_map import LandmarkMap
from uav_vslam.slam.map_manager import MapView, rows_to_remove
from uav_vslam.slam.map_matching import MIN_INLIERS, MapMatcher
from uav_vslam.slam.matches import Matches
from uav_vslam.slam.second_views import SecondViews
from uav_vslam.slam.track_window import TrackWindow
from uav_vslam.types import ImuIncrement, StereoFeatures

Rows = NDArray[np.intp]

SIGNIFICANCE = 1e-6  # chi-square tail probability below which a set of matches is rejected as a whole
FAR_SIGNIFICANCE = 1e-3  # of a set that puts the pose far away: on one side of an image a tilt fits like a shift
VISIT_FRAMES = 10  # typical frames for which a revisited landmark is in view


class LocalMap:
    """What is done with the landmarks of one filter; those still tracked are left to its window."""

    def __init__(
        self,
        landmarks: LandmarkMap,
        matcher: MapMatcher,
        *,
        slam_filter: Filter,
        window: TrackWindow,
        config: BackendConfig,
    ) -> None:
        self._map, self._matcher, self._config = landmarks, matcher, config
        self._filter, self._window = slam_filter, window
        self._second_views = SecondViews(slam_filter, landmarks)
        self._postponed: StereoFeatures | None = None  # frame that landmarks can't be added from yet

    def configure(self, config: BackendConfig) -> None:
        """Go on with live settings that have changed."""
        self._config = config
        self._matcher.configure(config)

    def correct(
        self, features: StereoFeatures, frame: int, *, by_landmarks: bool
    ) -> tuple[Matches, Innovation | None, int]:
        """Update with the first set of matches that passes the joint gate; without one, dead-reckon.

        Landmarks are left out where tracks show a motion that the IMU does not know: their gates would be too wide.
        A relocalisation is not gated by the prediction: it is tried when gating has failed.

        Args:
            features: of the frame.
            frame: its number.
            by_landmarks: use them, besides the tracks.

        Returns:
            The matches, the innovation, and how many of their landmarks had not been seen for long.
        """
        none, innovation = Matches.none(), None
        if self._filter.has_tracks:  # first, so that landmarks are gated on their own, with the better prediction
            innovation = self._filter.update(none.landmarks, none.pixels)
            if not by_landmarks:
                return none, innovation, 0
        self._begin(features)
        left_behind = self._map.long_unseen(frame)
        candidates = self._matcher.candidates(
            self._filter, self._map, features, frame, located=self._window.followed >= MIN_INLIERS
        )
        for found in candidates:
            matches = self._of_other_tracks(found, features)
            if len(matches) == 0:
                continue
            closures = int(left_behind[matches.landmarks].sum())
            revisited = (left_behind | self._map.revisited)[matches.landmarks]
            matches, of_landmarks = self._update(matches, visit_weights(revisited, self._config))
            if of_landmarks.accepted:
                seen = matches.features
                self._map.observe(matches.landmarks, features.descriptors[seen], frame, features.tracks[seen])
                self._window.views.forget_newest(features.tracks[seen])
                return matches, of_landmarks, closures
        return none, innovation, 0

    def _update(self, matches: Matches, weights: NDArray[np.float64]) -> tuple[Matches, Innovation]:
        """Update the filter with matches; return those whose landmarks are kept, and the innovation."""
        second = self._second_views.among(matches) if self._is_alone else np.zeros(len(matches), bool)
        tried = copy.copy(self._filter) if second.any() else self._filter
        innovation = tried.update(
            matches.landmarks,
            matches.pixels,
            linearise_at=matches.linearise_at,
            significance=_significance(matches),
            weights=weights,
        )
        if tried is not self._filter and innovation.accepted:
            second[innovation.outliers] = False
            matches = self._second_views.update(matches, second, at=tried.mean, weights=weights)
        return matches, innovation

    def _begin(self, features: StereoFeatures) -> None:
        """Begin a frame to which the filter has been predicted."""
        if self._is_alone:
            self._second_views.begin(features)

    @property
    def _is_alone(self) -> bool:
        """Whether the past poses are those of landmarks, because there are no tracks."""
        return self._window.keeps_poses and not self._window.has_frames

    def remove_surplus(self, frame: int) -> None:
        """Remove landmarks so that the cost of a frame stays bounded, and past poses that have left the window."""
        removed = np.zeros(0, np.intp)
        if len(self._map):
            in_view = self._in_view(self._filter.points_left(), frame)
            view = MapView(self._map, self._filter.landmarks, self._variance, in_view, frame)
            removed = rows_to_remove(view, self._config)
        past = self._second_views.past_to_drop() if self._is_alone else self._window.drop_oldest()
        if len(removed) or len(past):
            self._filter.marginalise(removed, past)
            self._map.remove(removed)

    def add(self, features: StereoFeatures, frame: int, *, matches: Matches) -> Rows:
        """Initialise landmarks from a frame's unmatched features, up to the capacity; return the features' rows.

        A filter that needs the angular rate for them adds them by `add_postponed`.
        """
        self._begin(features)
        added = self._added(features, frame, matched=matches.features)
        self._postponed = None if self._filter.can_add_landmarks else features
        return added

    def add_postponed(self, increment: ImuIncrement, frame: int) -> Rows:
        """Add the landmarks of the frame at the increment's start, if they had to wait for the angular rate there.

        Return the rows of its features.
        """
        if self._postponed is None:
            return np.zeros(0, np.intp)
        self._filter.starts(increment)
        self._begin(self._postponed)
        return self._added(self._postponed, frame, matched=Matches.none().features)

    def sightings(self, matches: Matches) -> Rows:
        """Return (K, 2) identifier and feature row of matches."""
        return np.column_stack([self._map.ids[matches.landmarks], matches.features])

    def new_sightings(self, added: Rows) -> Rows:
        """Return (K, 2) identifier and feature row of the landmarks just added from the features' rows `added`."""
        return np.column_stack([self._map.ids[len(self._map) - len(added) :], added])

    def new_landmarks(self, pixels: NDArray[np.floating], frame: int) -> Rows:
        """Return the rows of those of (N, 2) points of a frame that may become landmarks, up to the capacity."""
        most = min(self._config.max_new_landmarks, self._config.max_landmarks - len(self._map))
        return self._spread(pixels, frame, most)

    def all_in_view(self, pixels: NDArray[np.floating], frame: int) -> Rows:
        """Return the rows of those of (N, 2) points that joint information has as landmarks: as many as fit."""
        return self._spread(pixels, frame, self._config.max_in_view)

    def _of_other_tracks(self, matches: Matches, features: StereoFeatures) -> Matches:
        """Leave out landmarks that are still on the track that made them: its views are used as a track's."""
        if self._window.followed == 0:
            return matches
        tracks = features.tracks[matches.features]
        same = (self._map.tracks[matches.landmarks] == tracks) & (tracks != 0)  # without a track, both have 0
        return matches.chosen(np.flatnonzero(~same | self._map.revisited[matches.landmarks]))

    def _variance(self) -> NDArray[np.float64]:
        marginals = self._filter.belief.marginals(np.arange(len(self._map)))
        return np.asarray(np.trace(marginals.landmarks, axis1=1, axis2=2))

    def _added(self, features: StereoFeatures, frame: int, *, matched: Rows) -> Rows:
        free = np.setdiff1d(np.arange(len(features)), matched)
        if len(self._window.views):
            free = free[features.tracks[free] == 0]
        chosen = free[:0]
        if len(free) and self._filter.can_add_landmarks:
            chosen = free[self.new_landmarks(features.pixels[free, :2], frame)]
        if len(chosen):
            chosen = chosen[self._filter.add_landmarks(features.pixels[chosen].astype(float))]
            self._map.append(features.descriptors[chosen], frame, features.tracks[chosen])
        self._second_views.add(self._map.ids[len(self._map) - len(chosen) :], features.pixels[chosen].astype(float))
        return chosen

    def _in_view(self, points_left: NDArray[np.float64], frame: int) -> NDArray[np.bool_]:
        """Return (N,) which landmarks, at (N, 3) in the left camera, a frame should show.

        Those that frames have not shown for long count as gone: in hover and in a vertical climb they stay in the image
        for good, and would leave no room for points that can be seen.
        """
        return np.asarray(projectable(self._filter.rig, points_left) & ~self._map.long_unseen(frame))

    def _spread(self, pixels: NDArray[np.floating], frame: int, most: int) -> Rows:
        """Return the rows of at most so many of (N, 2) points; with the landmarks, they fill the image evenly."""
        rig, points_left = self._filter.rig, self._filter.points_left()
        in_view = self._in_view(points_left, frame)
        room = min(most, self._config.max_in_view - int(in_view.sum()))
        taken = rig.left.project(points_left[in_view])
        return spread(pixels, max(0, room), size=rig.left.size, taken=taken)


def visit_weights(revisited: NDArray[np.bool_], config: BackendConfig) -> NDArray[np.float64]:
    """Return weights of landmarks: the redetection error of a revisited one is common to all frames of a visit."""
    variance = config.sigma_px**2
    return np.where(revisited, variance / (variance + VISIT_FRAMES * config.redetection_px**2), 1.0)


def _significance(matches: Matches) -> float:
    """Return the tail probability below which a set is rejected; relocalisations are not tested by the prediction."""
    if matches.relocalised:
        return 0.0
    return SIGNIFICANCE if matches.linearise_at is None else FAR_SIGNIFICANCE
