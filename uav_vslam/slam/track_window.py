# SPDX-License-Identifier: Apache-2.0
"""Uses the tracks of points that are no landmarks: each once, when it has ended or fills the window.

Until then a track belongs to the estimate of the present only, a copy of the filter that has used all tracks so far: no
view is used twice, and none waits. The copy has landmarks only where they are asked for.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from uav_vslam.config import BackendConfig
from uav_vslam.estimation.belief import NO_ROWS
from uav_vslam.estimation.filter import Filter
from uav_vslam.estimation.tracks import MIN_VIEWS
from uav_vslam.estimation.weighted_update import Innovation
from uav_vslam.geometry.image_grid import spread
from uav_vslam.slam.landmark_map import LandmarkMap
from uav_vslam.slam.track_views import TrackViews
from uav_vslam.types import NS_PER_S, PoseEstimate, StereoFeatures

Rows = NDArray[np.intp]
Choice = Callable[[NDArray[np.float64]], Rows]  # rows of (N, 2) pixels whose points become landmarks

PRESENT_TRACKS = 50  # at most, the longest ones, spread over the image: twice as many change nothing
PUNCTUAL = 0.9  # of the spacing: frames may come a little early


@dataclass(frozen=True, slots=True)
class Present:
    """The estimate with all tracks.

    Attributes:
        filter: a copy that has used them, or the filter itself without tracks.
        innovation: None without tracks.
        rows: (K,) those used; if some were chosen as landmarks, these.
    """

    filter: Filter
    innovation: Innovation | None
    rows: Rows


class TrackWindow:
    """Up to `size` past poses besides the newest frame's; with a size of 0 it does nothing."""

    def __init__(self, size: int, config: BackendConfig) -> None:
        self._size, self._config = size, config
        self._ids: dict[int, int] = {}  # landmark identifiers of tracks that go on
        self.views = TrackViews()

    def configure(self, config: BackendConfig) -> None:
        """Go on with live settings that have changed."""
        self._config = config

    @property
    def followed(self) -> int:
        """Number of tracks that the newest frame continues."""
        return int((self.views.seen[:, -1] & (self.views.counts >= MIN_VIEWS)).sum()) if len(self.views) else 0

    @property
    def renewed(self) -> int:
        """Number of tracks that go on, but whose views up to the newest frame have been used."""
        return int(self.views.renewed.sum()) if len(self.views) else 0

    @property
    def has_frames(self) -> bool:
        """Whether there have been tracks: past poses of the filter are the frames of their views."""
        return self.views.frames > 0

    @property
    def keeps_poses(self) -> bool:
        """Whether the filter has room for past poses."""
        return self._size > 0

    def add_frame(self, slam_filter: Filter, features: StereoFeatures) -> None:
        """Keep the pose of a frame, to which the filter has been predicted, and the views of its tracked points."""
        if self._size and (len(self.views) or features.tracks.any()):
            if not self.has_frames:  # the poses of frames without tracks are no frames of the views
                slam_filter.marginalise(NO_ROWS, np.arange(len(slam_filter.past)))
            self._thin_out(slam_filter)
            slam_filter.keep_pose()
            self.views.add_frame(features)

    def finish(
        self, slam_filter: Filter, landmark_map: LandmarkMap, frame: int, choose: Choice, *, everything: bool = False
    ) -> int:
        """Use the tracks that have ended or fill the window, in the filter's next update; some become landmarks.

        Return how many of those that passed the gate the newest frame shows.

        Args:
            slam_filter: its past poses are the frames of the views.
            landmark_map: gets the new landmarks.
            frame: number of the newest one.
            choose: by where points were seen last.
            everything: use all tracks, because the newest pose is known by them alone.
        """
        views = self.views
        if len(views) == 0:
            return 0
        finished = ~views.seen[:, -1] | everything
        if self._is_full:
            finished |= views.seen[:, 0]
        used = np.flatnonzero(finished & (views.counts >= MIN_VIEWS))
        new = self._chosen(used, landmark_map, choose)
        passed = slam_filter.observe_tracks(
            views.chosen(used),
            probability=self._config.gate_probability,
            become_landmarks=np.isin(used, new),
            others=lambda: views.chosen(self._longest(slam_filter, ~finished)),
        )
        new = np.intersect1d(new, used[passed])
        landmark_map.append(
            views.descriptors[new],
            frame,
            views.tracks[new],
            ids=self.identified(new, landmark_map),
            observations=views.counts[new],
        )
        going_on = views.tracks[views.seen[:, -1]].tolist()
        self._ids = {track: self._ids[track] for track in going_on if track in self._ids}
        shown = int((views.seen[used, -1] & passed).sum())
        views.use(used)
        views.remove(finished)
        return shown

    def present(self, slam_filter: Filter, landmark_map: LandmarkMap, choose: Choice | None = None) -> Present:
        """Return the estimate of the present.

        Args:
            slam_filter: is left as it is.
            landmark_map: its landmarks.
            choose: which points of the tracks are landmarks, besides the filter's; None for an estimate that need not
                have any.
        """
        views = self.views
        used = self._longest(slam_filter, np.ones(len(views), bool))
        if len(used) == 0:
            return Present(slam_filter, None, used)
        new = used[:0] if choose is None else self._chosen(used, landmark_map, choose)
        before = slam_filter.without_landmarks() if choose is None else slam_filter
        with_tracks, passed, innovation = before.with_tracks(
            views.chosen(used), probability=self._config.gate_probability, become_landmarks=np.isin(used, new)
        )
        rows = used[passed]
        return Present(with_tracks, innovation, rows if choose is None else np.intersect1d(new, rows))

    def identified(self, rows: Rows, landmark_map: LandmarkMap) -> NDArray[np.uint32]:
        """Return the (K,) landmark identifiers of K rows of the tracks, new ones where they have none."""
        tracks = self.views.tracks[rows].tolist()
        fresh = [track for track in tracks if track not in self._ids]
        self._ids.update(zip(fresh, landmark_map.new_ids(len(fresh)).tolist(), strict=True))
        return np.array([self._ids[track] for track in tracks], np.uint32)

    def leaving(self, slam_filter: Filter) -> PoseEstimate | None:
        """Return the oldest past pose if it is about to leave the full window."""
        return slam_filter.past_estimate(0) if self._is_full else None

    def drop_oldest(self) -> NDArray[np.int64]:
        """Drop the oldest frame of a full window; return the rows of past poses that the filter need not keep."""
        if not self._is_full:
            return NO_ROWS
        self.views.drop_frame(0)
        return np.zeros(1, np.int64)

    @property
    def _is_full(self) -> bool:
        return self.views.frames > self._size

    def _thin_out(self, slam_filter: Filter) -> None:
        """Drop the newest past pose if it is too close to the one before."""
        stamps_ns = slam_filter.past.stamps_ns
        if len(stamps_ns) < 2:
            return
        spacing_s = (stamps_ns[-1] - stamps_ns[-2]) / NS_PER_S
        if spacing_s < PUNCTUAL * self._config.window_spacing_s:
            newest = len(stamps_ns) - 1
            slam_filter.marginalise(NO_ROWS, np.array([newest]))
            self.views.drop_frame(newest)

    def _longest(self, slam_filter: Filter, among: NDArray[np.bool_]) -> Rows:
        """Return the rows of the longest tracks, at most `PRESENT_TRACKS`, spread over the image."""
        rows = np.flatnonzero(among & (self.views.counts >= MIN_VIEWS))
        if len(rows) == 0:
            return rows
        rows = rows[np.argsort(-self.views.counts[rows], kind="stable")]
        pixels, size = self.views.chosen(rows).newest_pixels[:, :2], slam_filter.rig.left.size
        return np.sort(rows[spread(pixels, PRESENT_TRACKS, size=size)])

    def _chosen(self, rows: Rows, landmark_map: LandmarkMap, choose: Choice) -> Rows:
        """Return those of some tracks that were seen often enough for a landmark, have none yet, and are chosen."""
        old = rows[self.views.counts[rows] >= self._config.landmark_views]
        old = old[~np.isin(self.views.tracks[old], landmark_map.tracks)]
        return np.sort(old[choose(self.views.chosen(old).newest_pixels[:, :2])])
