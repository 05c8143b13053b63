# SPDX-License-Identifier: Apache-2.0
"""Which features of a flight show the same point, and which points are the same place seen again.

A point is a feature track, at most `MAX_SPAN` frames of it; without tracks, a landmark as the filter associated it.
Where a tracked landmark is found again by a new detection, that is a new point: detections repeat worse than tracks.
Only landmarks seen again after `LONG_FRAMES` tie their visits together, with the uncertainty of the redetection: they
close a loop. Between two frames with few common tracks, landmarks tie what is on either side, and lone tracks are cut.
"""

import dataclasses
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from uav_vslam.slam.landmark_map import LONG_FRAMES
from uav_vslam.smoothing.flight import FilteredFlight

Array = NDArray[np.float64]
Rows = NDArray[np.intp]

MAX_SPAN = 48  # frames of one point: the cost of a frame grows with its square
FEW_TRACKS = 10  # that go on from frame to frame: below, landmarks help to hold the frames together
LONE_TRACKS = 4  # below, flow has found them by chance in two images that share nothing
MAX_LANDMARKS = 100  # that close loops, with 3 unknowns each in the border of the normal equations


@dataclass(frozen=True, slots=True)
class Sightings:
    """All observations of P points, ordered by the point's first state, point and state.

    Attributes:
        states: (M,) row of the state that each was made in.
        points: (M,) row of the point, ascending.
        pixels: (M, 4) stereo pixels.
        landmarks: (P,) row of the revisited landmark that a point shows; -1 for nearly all.
        ids: (P,) the filter's identifier of the landmark that a point shows; 0 for none.
        tracked: the points are tracked from frame to frame, not detected afresh in each.
    """

    states: Rows
    points: Rows
    pixels: Array
    landmarks: Rows
    ids: Rows
    tracked: bool

    @property
    def starts(self) -> Rows:
        """(P,) first observation of each point."""
        return np.searchsorted(self.points, np.arange(len(self.landmarks)))

    @property
    def longest(self) -> int:
        """Largest number of states from a point's first to its last."""
        if len(self.points) == 0:
            return 1
        ends = np.append(self.starts[1:], len(self.points)) - 1
        return int((self.states[ends] - self.states[self.starts]).max()) + 1

    def by_block(self, size: int) -> Iterator[tuple[int, slice, "Sightings"]]:
        """Yield block, rows of the points, and the points that start in each block of `size` states, from zero on."""
        starts = self.starts
        blocks = self.states[starts] // size
        ends = np.append(starts, len(self.points))
        for block in np.unique(blocks).tolist():
            first, last = np.searchsorted(blocks, [block, block + 1]).tolist()
            seen, own = slice(ends[first], ends[last]), slice(first, last)
            part = Sightings(
                self.states[seen],
                self.points[seen] - first,
                self.pixels[seen],
                self.landmarks[own],
                self.ids[own],
                self.tracked,
            )
            yield block, own, part

    def chosen(self, keep: NDArray[np.bool_]) -> "Sightings":
        """Return those of the points in a (P,) mask; a landmark left with one point closes no loop."""
        rows = keep[self.points]
        number = np.cumsum(keep) - 1
        landmarks = _renumbered(self.landmarks[keep])
        points = number[self.points[rows]]
        return Sightings(self.states[rows], points, self.pixels[rows], landmarks, self.ids[keep], self.tracked)

    def untied(self, landmarks: Rows) -> "Sightings":
        """Return these points with none showing any of some landmarks, given by row."""
        rest = np.where(np.isin(self.landmarks, landmarks), -1, self.landmarks)
        return dataclasses.replace(self, landmarks=_renumbered(rest))


def _renumbered(landmarks: Rows) -> Rows:
    """Number the landmarks that several points show from zero on; -1 for all others."""
    names, counts = np.unique(landmarks[landmarks >= 0], return_counts=True)
    again = names[counts > 1]
    shown = np.isin(landmarks, again)
    return np.where(shown, np.searchsorted(again, landmarks), -1).astype(np.intp)


def gather(flight: FilteredFlight) -> Sightings:
    """Return all observations of a flight that say something about its motion."""
    states, pixels, tracks, ids = _columns(flight)
    labels = np.where(tracks > 0, tracks, -ids)  # 0: neither tracked nor associated
    known = np.flatnonzero(labels != 0)
    order = known[np.lexsort((states[known], labels[known]))]
    states, pixels, labels, ids = states[order], pixels[order], labels[order], ids[order]
    going_on = _going_on(flight)
    points = _segments(labels, states, np.cumsum(going_on < LONE_TRACKS))
    count = int(points[-1]) + 1 if len(points) else 0
    landmarks = _revisited(points, states, ids, count, np.cumsum(going_on < FEW_TRACKS))
    first = states[np.searchsorted(points, np.arange(count))]
    number = np.empty(count, np.intp)
    number[np.argsort(first, kind="stable")] = np.arange(count)
    order = np.argsort(number[points], kind="stable")
    ordered, shown = np.empty(count, np.intp), np.empty(count, np.intp)
    ordered[number], shown[number] = landmarks, _shown(points, ids, count)
    tracked = bool((labels > 0).any())
    sightings = Sightings(states[order], number[points][order], pixels[order], ordered, shown, tracked)
    repeated = np.bincount(sightings.points, minlength=count) > 1
    return sightings.chosen(repeated | (ordered >= 0))


def _columns(flight: FilteredFlight) -> tuple[Rows, Array, Rows, Rows]:
    """Return state row, pixels, track (0 for none) and landmark identifier (0 for none) of all features."""
    states, pixels, tracks, ids = [], [], [], []
    for row, frame in zip(flight.state_rows.tolist(), flight.frames, strict=True):
        sighted = np.zeros(len(frame.features), np.intp)
        sighted[frame.sightings[:, 1]] = frame.sightings[:, 0]
        states.append(np.full(len(sighted), row))
        pixels.append(frame.features.pixels.astype(float))
        tracks.append(frame.features.tracks.astype(np.intp))
        ids.append(sighted)
    none = np.zeros(0, np.intp)
    return (
        np.concatenate([none, *states]),
        np.concatenate([np.zeros((0, 4)), *pixels]),
        np.concatenate([none, *tracks]),
        np.concatenate([none, *ids]),
    )


def _going_on(flight: FilteredFlight) -> Rows:
    """Return (S,) how many tracks go on to each state from the frame before; `FEW_TRACKS` in a flight without any."""
    counts, before = np.full(len(flight.states), FEW_TRACKS), np.zeros(0, np.uint32)
    if not any(frame.features.tracks.any() for frame in flight.frames):
        return counts
    for row, frame in zip(flight.state_rows.tolist(), flight.frames, strict=True):
        tracks = frame.features.tracks[frame.features.tracks != 0]
        counts[row] = len(np.intersect1d(tracks, before))
        before = tracks
    return counts


def _segments(labels: Rows, states: Rows, stretches: Rows) -> Rows:
    """Number the parts of each label without a long gap, each in at most `MAX_SPAN` states of one of the stretches."""
    if len(labels) == 0:
        return labels
    apart = (np.diff(labels) != 0) | (np.diff(states) >= LONG_FRAMES) | (np.diff(stretches[states]) != 0)
    starts = np.flatnonzero(np.append(True, apart))
    stretch = np.cumsum(np.append(False, apart))
    part = (states - states[starts][stretch]) // MAX_SPAN
    return np.cumsum(np.append(False, apart | (np.diff(part) != 0)))


def _shown(points: Rows, ids: Rows, count: int) -> Rows:
    """Return (P,) the landmark that each point was associated with most often; 0 for none."""
    seen = ids > 0
    pairs, times = np.unique(np.column_stack([points[seen], ids[seen]]), axis=0, return_counts=True)
    shown = np.zeros(count, np.intp)
    rising = np.argsort(times, kind="stable")
    shown[pairs[rising, 0]] = pairs[rising, 1]  # of several, the last one counts
    return shown


def _revisited(points: Rows, states: Rows, ids: Rows, count: int, stretches: Rows) -> Rows:
    """Return (P,) the number of the revisited landmark that each point shows, -1 for none; (S,) stretches of states.

    Of each visit, the point with most observations stands for the landmark.
    """
    landmarks = np.full(count, -1)
    seen = np.flatnonzero(ids > 0)
    order = seen[np.lexsort((states[seen], ids[seen]))]
    sorted_ids, sorted_states = ids[order], states[order]
    new_id = np.diff(sorted_ids, prepend=-1) != 0
    long_ago = np.diff(sorted_states, prepend=0) >= LONG_FRAMES
    visits = np.cumsum(new_id | long_ago | (np.diff(stretches[sorted_states], prepend=0) != 0)) - 1
    visit_ids = sorted_ids[np.searchsorted(visits, np.arange(visits[-1] + 1))] if len(visits) else sorted_ids
    names, visits_of = np.unique(visit_ids, return_counts=True)
    again = names[np.argsort(-visits_of, kind="stable")][: int((visits_of > 1).sum())][:MAX_LANDMARKS]
    for visit in np.flatnonzero(np.isin(visit_ids, again)).tolist():
        shown = points[order[visits == visit]]
        landmarks[np.bincount(shown).argmax()] = int(np.flatnonzero(again == visit_ids[visit])[0])
    return landmarks
