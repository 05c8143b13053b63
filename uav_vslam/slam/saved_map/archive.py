# SPDX-License-Identifier: Apache-2.0
"""Collects the landmarks of a flight: each is kept in a section before or soon after it leaves the filter.

Landmarks that have left are remembered, conditioned on those that stay, until there are enough of them for a section;
those in view that have been observed often enough join it. So a section covers about one view of the ground, and its
landmarks, of one joint belief, have a true joint covariance.
"""

import dataclasses
from collections import Counter

import numpy as np
from numpy.typing import NDArray

from uav_vslam.estimation.belief import landmark_rows
from uav_vslam.geometry.image_grid import spread_after
from uav_vslam.geometry.pose import POSE_DIM
from uav_vslam.numerics import cholesky, submatrix
from uav_vslam.slam.landmark_memory import LandmarkMemory
from uav_vslam.slam.saved_map.record import MapOrigin, Mapped, MappedPlace
from uav_vslam.types import JointInformation

Array = NDArray[np.float64]
Rows = NDArray[np.intp]

MIN_OBSERVATIONS = 3  # of a landmark in the filter that joins a section
LEFT_FOR_SECTION = 24  # landmarks that have left: a section is made of them and of those in view
SECTION_LANDMARKS = 64  # at most: the time to bound its covariance grows with the cube


class MapArchive:
    """All landmarks that one vehicle has mapped in one session."""

    def __init__(self, origin: MapOrigin) -> None:
        """Start empty; the origin's stamp follows the beliefs."""
        self.origin = origin
        self._memory = LandmarkMemory(SECTION_LANDMARKS)
        self._observations: Counter[int] = Counter()
        self._stored: set[int] = set()
        self._parts: list[MappedPlace] = []

    def count(self, sightings: Rows) -> None:
        """Count a frame's observations: (K, 2) identifier and feature row."""
        self._observations.update(sightings[:, 0].tolist())

    def add(self, joint: JointInformation) -> None:
        """Take over a belief, later than the last one.

        Raises:
            FilterDivergence: its information, or the covariance of some landmarks, is not positive definite.
        """
        cholesky(joint.information, "joint information")  # taken over, it would fail each later belief, and `mapped`
        last = self._memory.last
        if last is not None and not np.isin(self._memory.in_state, joint.ids).any():
            self._parts += self._rest()  # the filter was re-initialised: nothing relates it to the past
            self._stored |= set(last.ids.tolist())
        wanted = set() if last is None else set(last.ids.tolist()) - self._stored
        belief = self._memory.extended(joint, wanted)
        open_rows = self._open(belief)
        left = open_rows[~np.isin(belief.ids[open_rows], joint.ids)]
        if len(left) >= LEFT_FOR_SECTION:
            rows = self._chosen(belief, left, open_rows)
            self._parts.append(_place(belief, rows))
            self._stored |= set(belief.ids[rows].tolist())

    def mapped(self) -> Mapped:
        """Return all that has been mapped; what is still in the filter is in the last place."""
        stamp_ns = 0 if self._memory.last is None else self._memory.last.stamp_ns
        places = (
            dataclasses.replace(place, observations=self._counted(place.ids)) for place in [*self._parts, *self._rest()]
        )
        return Mapped(dataclasses.replace(self.origin, stamp_ns=stamp_ns), tuple(places))

    def _counted(self, ids: NDArray[np.uint32]) -> NDArray[np.uint32]:
        return np.array([self._observations[i] for i in ids.tolist()], np.uint32)

    def _open(self, belief: JointInformation) -> Rows:
        """Return the rows of landmarks that are in no section yet: remembered, or observed often enough."""
        stored = np.array([i in self._stored for i in belief.ids.tolist()], bool)
        young = np.isin(belief.ids, self._memory.in_state) & (self._counted(belief.ids) < MIN_OBSERVATIONS)
        return np.flatnonzero(~stored & ~young)

    def _chosen(self, belief: JointInformation, left: Rows, rows: Rows) -> Rows:
        """Return the rows of a section: those that have left, then the others, spread over the ground."""
        others = rows[~np.isin(rows, left)]
        return np.sort(spread_after(belief.positions, left, others, SECTION_LANDMARKS))

    def _rest(self) -> list[MappedPlace]:
        """Return sections of all landmarks of the last belief that are in none yet."""
        belief, parts = self._memory.last, []
        rows = np.zeros(0, np.intp) if belief is None else self._open(belief)
        while belief is not None and len(rows):
            some = self._chosen(belief, rows[:0], rows)
            parts.append(_place(belief, some))
            rows = rows[~np.isin(rows, some)]
        return parts


def _place(belief: JointInformation, rows: Rows) -> MappedPlace:
    columns = landmark_rows(POSE_DIM, rows)
    return MappedPlace.of(
        belief.ids[rows],
        belief.positions[rows].copy(),
        submatrix(belief.covariance, columns),
        descriptors=belief.descriptors[rows].copy(),
        observations=np.zeros(len(rows), np.uint32),  # counted when they are wanted
    )
