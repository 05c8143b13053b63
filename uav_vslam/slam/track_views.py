# SPDX-License-Identifier: Apache-2.0
"""Where points that are no landmarks were seen, at the filter's past poses."""

import numpy as np
from numpy.typing import NDArray

from uav_vslam.estimation.past_poses import Tracks
from uav_vslam.types import StereoFeatures

Mask = NDArray[np.bool_]
Rows = NDArray[np.intp]


class TrackViews:
    """A table of T tracks by V frames, oldest first; frame k was taken at past pose k.

    Attributes:
        tracks: (T,) the front end's numbers, ascending.
        pixels: (T, V, 4) stereo pixels.
        seen: (T, V).
        descriptors: (T, D) newest ones.
    """

    def __init__(self, frames: int = 0) -> None:
        self.tracks: NDArray[np.uint32] = np.zeros(0, np.uint32)
        self.pixels: NDArray[np.float64] = np.zeros((0, frames, 4))
        self.seen: Mask = np.zeros((0, frames), bool)
        self.descriptors: NDArray[np.uint8] = np.zeros((0, 0), np.uint8)

    def __len__(self) -> int:
        return len(self.tracks)

    @property
    def counts(self) -> Rows:
        """(T,) in how many frames each was seen."""
        return np.asarray(self.seen.sum(axis=1), dtype=np.intp)

    @property
    def newest_pixels(self) -> NDArray[np.float64]:
        """(T, 4) where each was seen last."""
        newest = self.seen.shape[1] - 1 - np.argmax(self.seen[:, ::-1], axis=1)
        return np.asarray(self.pixels[np.arange(len(self)), newest])

    def chosen(self, rows: Rows) -> Tracks:
        """Return some of the tracks."""
        return Tracks(self.pixels[rows], self.seen[rows])

    def add_frame(self, features: StereoFeatures) -> None:
        """Append a frame with its tracked points."""
        shown = features.chosen(np.flatnonzero(features.tracks))
        frames, tracks = self.seen.shape[1], np.union1d(self.tracks, shown.tracks)
        old, new = np.searchsorted(tracks, self.tracks), np.searchsorted(tracks, shown.tracks)
        wider = TrackViews(frames + 1)
        wider.tracks = tracks
        wider.pixels, wider.seen = np.zeros((len(tracks), frames + 1, 4)), np.zeros((len(tracks), frames + 1), bool)
        wider.descriptors = np.zeros((len(tracks), shown.descriptors.shape[1]), np.uint8)
        wider.pixels[old, :-1], wider.seen[old, :-1] = self.pixels, self.seen
        if len(old):
            wider.descriptors[old] = self.descriptors
        wider.pixels[new, -1], wider.seen[new, -1], wider.descriptors[new] = shown.pixels, True, shown.descriptors
        self._become(wider)

    def forget_newest(self, tracks: NDArray[np.uint32]) -> None:
        """Forget the views of some tracks in the newest frame: they have been used as landmarks."""
        self.seen[np.isin(self.tracks, tracks), -1:] = False
        self.remove(np.asarray(~self.seen.any(axis=1)))

    def drop_frame(self, frame: int) -> None:
        """Drop a frame, and the tracks that were seen in no other."""
        self.pixels, self.seen = np.delete(self.pixels, frame, axis=1), np.delete(self.seen, frame, axis=1)
        self.remove(np.asarray(~self.seen.any(axis=1)))

    def remove(self, rows: Mask) -> None:
        """Remove tracks."""
        for name in ("tracks", "pixels", "seen", "descriptors"):
            setattr(self, name, getattr(self, name)[~rows])

    def _become(self, other: "TrackViews") -> None:
        self.__dict__.update(other.__dict__)
