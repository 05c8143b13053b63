# SPDX-License-Identifier: Apache-2.0
"""Where points that are no landmarks were seen, at the filter's past poses."""

import numpy as np
from numpy.typing import NDArray

from uav_vslam.estimation.tracks import Tracks
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

    def __init__(self) -> None:
        self.tracks: NDArray[np.uint32] = np.zeros(0, np.uint32)
        self.pixels: NDArray[np.float64] = np.zeros((0, 0, 4))
        self.seen: Mask = np.zeros((0, 0), bool)
        self.descriptors: NDArray[np.uint8] = np.zeros((0, 0), np.uint8)
        self._uses: dict[int, int] = {}  # of tracks that go on

    def __len__(self) -> int:
        return len(self.tracks)

    @property
    def frames(self) -> int:
        """V."""
        return self.seen.shape[1]

    @property
    def counts(self) -> Rows:
        """(T,) in how many frames each was seen."""
        return np.asarray(self.seen.sum(axis=1), dtype=np.intp)

    def chosen(self, rows: Rows) -> Tracks:
        """Return some of the tracks."""
        earlier = np.array([self._uses.get(track, 0) for track in self.tracks[rows].tolist()], np.intp)
        return Tracks(self.pixels[rows], self.seen[rows], earlier)

    def add_frame(self, features: StereoFeatures) -> None:
        """Append a frame with its tracked points."""
        shown = features.chosen(np.flatnonzero(features.tracks))
        frames, tracks = self.frames, np.union1d(self.tracks, shown.tracks)
        old, new = np.searchsorted(tracks, self.tracks), np.searchsorted(tracks, shown.tracks)
        pixels, seen = np.zeros((len(tracks), frames + 1, 4)), np.zeros((len(tracks), frames + 1), bool)
        pixels[old, :frames], seen[old, :frames] = self.pixels, self.seen
        pixels[new, frames], seen[new, frames] = shown.pixels, True
        width = (self if len(self) else shown).descriptors.shape[1]  # a frame without points has that of SIFT
        descriptors = np.zeros((len(tracks), width), np.uint8)
        if len(self):
            descriptors[old] = self.descriptors
        if len(shown):
            descriptors[new] = shown.descriptors
        self.tracks, self.pixels, self.seen, self.descriptors = tracks, pixels, seen, descriptors
        self._uses = {track: self._uses[track] for track in shown.tracks.tolist() if track in self._uses}

    @property
    def renewed(self) -> Mask:
        """(T,) whether the newest view is the only one that has not been used."""
        used = np.isin(self.tracks, list(self._uses))
        return np.asarray(used & (self.counts == 1) & self.seen[:, -1])

    def use(self, rows: Rows) -> None:
        """Count the use of some tracks; their views are to be removed."""
        self._uses |= {track: self._uses.get(track, 0) + 1 for track in self.tracks[rows].tolist()}

    def forget_newest(self, tracks: NDArray[np.uint32]) -> None:
        """Forget the views of some tracks in the newest frame: they have been used as landmarks."""
        self.seen[np.isin(self.tracks, tracks), -1:] = False
        self.remove(np.asarray(~self.seen.any(axis=1)))

    def drop_frame(self, frame: int) -> None:
        """Drop a frame, and the tracks that were seen in no other."""
        self.pixels, self.seen = np.delete(self.pixels, frame, axis=1), np.delete(self.seen, frame, axis=1)
        self.remove(np.asarray(~self.seen.any(axis=1)))

    def remove(self, which: Mask) -> None:
        """Remove those of the T tracks."""
        kept = ~which
        self.tracks, self.pixels = self.tracks[kept], self.pixels[kept]
        self.seen, self.descriptors = self.seen[kept], self.descriptors[kept]
