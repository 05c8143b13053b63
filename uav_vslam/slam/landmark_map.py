# SPDX-License-Identifier: Apache-2.0
"""Landmark data besides the estimate; row k here is row k of the filter's landmarks."""

import numpy as np
from numpy.typing import NDArray

from uav_vslam.association import InView
from uav_vslam.association.descriptor_statistics import DescriptorStatistics

Rows = NDArray[np.intp]

LONG_FRAMES = 30  # a landmark last observed so many frames ago, or more, closes a loop when it is observed again


class LandmarkMap:
    """Identifiers, descriptors and history of N landmarks, kept consistent with the filter by `append` and `remove`.

    Attributes:
        ids: (N,) identifiers.
        descriptors: (N, D) newest ones; D is that of the first landmarks.
        statistics: of all descriptors.
        born, seen: (N,) frame numbers of the first and the last observation.
        observations: (N,) how many.
        revisited: (N,) observed again after being long unseen.
        tracks: (N,) the front end's, as last observed; 0 for none.
    """

    def __init__(self) -> None:
        self.ids: NDArray[np.uint32] = np.zeros(0, np.uint32)
        self.descriptors: NDArray[np.uint8] = np.zeros((0, 128), np.uint8)
        self.statistics = DescriptorStatistics.of(self.descriptors)
        self.born: Rows = np.zeros(0, np.intp)
        self.seen: Rows = np.zeros(0, np.intp)
        self.observations: Rows = np.zeros(0, np.intp)
        self.revisited: NDArray[np.bool_] = np.zeros(0, bool)
        self.tracks: NDArray[np.uint32] = np.zeros(0, np.uint32)
        self._next_id = 1

    def __len__(self) -> int:
        return len(self.ids)

    def long_unseen(self, frame: int) -> NDArray[np.bool_]:
        """Return (N,) which landmarks were last observed `LONG_FRAMES` or more before a frame."""
        return np.asarray(frame - self.seen >= LONG_FRAMES)

    def new_ids(self, count: int) -> NDArray[np.uint32]:
        """Return (count,) new identifiers."""
        fresh = np.arange(self._next_id, self._next_id + count, dtype=np.uint32)
        self._next_id += count
        return fresh

    def skip_ids(self, count: int) -> None:
        """Never give out the next `count` identifiers."""
        self._next_id += count

    def continue_ids(self, other: "LandmarkMap") -> None:
        """Give out the identifiers that another map would give out next."""
        self._next_id = other._next_id

    def append(
        self,
        descriptors: NDArray[np.uint8],
        frame: int,
        tracks: NDArray[np.uint32],
        *,
        ids: NDArray[np.uint32] | None = None,
        observations: Rows | int = 1,
    ) -> None:
        """Add landmarks with (M, D) descriptors and (M,) tracks, observed that often; `ids` are new unless given."""
        count = len(descriptors)
        self.ids = np.concatenate([self.ids, self.new_ids(count) if ids is None else ids])
        if len(self.descriptors) == 0:
            self.descriptors = self.descriptors.reshape(0, descriptors.shape[1])
        self.descriptors = np.vstack([self.descriptors, descriptors])
        self.statistics.append(descriptors)
        self.born = np.concatenate([self.born, np.full(count, frame)])
        self.seen = np.concatenate([self.seen, np.full(count, frame)])
        self.observations = np.concatenate([self.observations, np.full(count, observations, np.intp)])
        self.revisited = np.concatenate([self.revisited, np.zeros(count, bool)])
        self.tracks = np.concatenate([self.tracks, tracks])

    def observe(self, rows: Rows, descriptors: NDArray[np.uint8], frame: int, tracks: NDArray[np.uint32]) -> None:
        """Record observations of K `rows`; their newest descriptors (K, D) and tracks (K,) replace the old ones.

        A continued track keeps its first descriptor: the same descriptor again is not another view.
        """
        fresh = (self.descriptors[rows] != descriptors).any(axis=1)
        self.statistics.observe(rows[fresh], descriptors[fresh])
        self.descriptors[rows] = descriptors
        self.revisited[rows] |= self.long_unseen(frame)[rows]
        self.seen[rows] = frame
        self.observations[rows] += 1
        self.tracks[np.isin(self.tracks, tracks)] = 0  # a track observes one landmark only
        self.tracks[rows] = tracks

    def in_view(self, rows: Rows, expected: NDArray[np.float64], S: NDArray[np.float64]) -> InView:
        """Return landmarks predicted to be visible in a frame, as associators take them; see `InView`."""
        return InView(rows, expected, S, self.descriptors[rows], self.statistics.chosen(rows))

    def move_to_end(self, rows: Rows) -> None:
        """Put some landmarks behind all others."""
        self._choose(np.concatenate([np.delete(np.arange(len(self)), rows), rows]))

    def remove(self, rows: Rows) -> None:
        """Remove landmarks."""
        self._choose(np.delete(np.arange(len(self)), rows))

    def _choose(self, keep: Rows) -> None:
        """Keep some landmarks, in this order."""
        self.ids, self.descriptors = self.ids[keep], self.descriptors[keep]
        self.statistics = self.statistics.chosen(keep)
        self.born, self.seen, self.observations = self.born[keep], self.seen[keep], self.observations[keep]
        self.revisited, self.tracks = self.revisited[keep], self.tracks[keep]
