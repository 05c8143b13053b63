# SPDX-License-Identifier: Apache-2.0
"""Map management: which landmarks to remove, and how many to add, so that the cost of a frame is bounded."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from uav_vslam.config import BackendConfig
from uav_vslam.slam.landmark_map import LandmarkMap

Array = NDArray[np.float64]
Rows = NDArray[np.intp]

FAILED_AFTER_FRAMES = 3  # a rarely observed landmark, in view but unseen for so long, is bad
YOUNG_FRAMES = 5  # younger landmarks are not removed for space
ESTABLISHED_OBSERVATIONS = 3  # from so many observations on, a landmark is worth retaining
CELL_GROWTH = 2.0**0.25  # of the cell's side, if there are more cells than capacity
LARGEST_CELL_M = 1e4  # stops the growth of cells
THESIS_DROP_SHARE = 0.05  # section 7.4: the share with the largest covariance is removed each frame
THESIS_FIRST_SHARE = 0.5  # share of the capacity for the oldest landmarks in `first_last`


@dataclass(frozen=True, slots=True)
class MapView:
    """Input of a retention policy.

    Attributes:
        landmarks: history of the N landmarks.
        positions: (N, 3) [m].
        variance: computes the (N,) traces of the landmarks' covariances [m^2]; expensive, so on demand.
        in_view: (N,) predicted inside both images, but for those that were not seen there for long.
        frame: current frame number.
    """

    landmarks: LandmarkMap
    positions: Array
    variance: Callable[[], Array]
    in_view: NDArray[np.bool_]
    frame: int


class Retention(Protocol):
    """A policy: rows to remove."""

    def __call__(self, view: MapView, config: BackendConfig) -> Rows:
        """Return the rows to remove from the state."""


def keep_one_per_cell(view: MapView, config: BackendConfig) -> Rows:
    """Out of view, keep the most observed landmark of each ground cell: enough to close a loop.

    If there are more cells than capacity, cells grow until they fit: all ground flown over stays covered, with
    decreasing density, and the cost of a frame stays bounded.
    """
    out = np.flatnonzero(~view.in_view)
    order = out[np.argsort(-view.landmarks.observations[out], kind="stable")]
    order = order[view.landmarks.observations[order] >= ESTABLISHED_OBSERVATIONS]
    capacity, cell_m = capacity_out_of_view(view, config), config.retention_cell_m
    kept = order[_first_of_each_cell(view.positions[order], cell_m)]
    while len(kept) > capacity and cell_m < LARGEST_CELL_M:
        cell_m *= CELL_GROWTH
        kept = order[_first_of_each_cell(view.positions[order], cell_m)]
    return out[~np.isin(out, kept)]


def _first_of_each_cell(positions: Array, cell_m: float) -> Rows:
    """Return the first row of each ground cell, ascending."""
    cells = np.floor(positions[:, :2] / cell_m).astype(np.int64)
    _, first = np.unique(cells, axis=0, return_index=True)
    return np.sort(first)


def keep_none(view: MapView, config: BackendConfig) -> Rows:
    """Remove every landmark out of view."""
    return np.flatnonzero(~view.in_view)


def keep_most_observed(view: MapView, config: BackendConfig) -> Rows:
    """Out of view, keep as many as fit: rarely observed ones go first, of equals the longest unseen.

    For image spacings at which even landmarks with few observations are worth keeping.
    """
    out = np.flatnonzero(~view.in_view)
    often = np.minimum(view.landmarks.observations[out], ESTABLISHED_OBSERVATIONS)
    order = out[np.lexsort((view.landmarks.seen[out], often))]
    return order[: max(0, len(out) - capacity_out_of_view(view, config))]


def keep_first_and_last(view: MapView, config: BackendConfig) -> Rows:
    """Keep the first N1 and the last N2 landmarks of the flight, as the thesis does."""
    surplus = max(0, len(view.landmarks) - (config.max_landmarks - _new_landmarks(view, config)))
    first = round(THESIS_FIRST_SHARE * (len(view.landmarks) - surplus))
    return np.argsort(view.landmarks.born, kind="stable")[first : first + surplus]


def drop_largest_covariance(view: MapView, config: BackendConfig) -> Rows:
    """Remove the 5 % with the largest covariance of the previous step, as section 7.4 of the thesis does."""
    settled = np.flatnonzero(view.landmarks.born < view.frame)
    count = int(THESIS_DROP_SHARE * len(settled))
    return settled[np.argsort(-view.variance()[settled], kind="stable")[:count]]


RETENTION: dict[str, Retention] = {
    "grid": keep_one_per_cell,
    "most_observed": keep_most_observed,
    "none": keep_none,
    "first_last": keep_first_and_last,
    "largest_covariance": drop_largest_covariance,
}


def rows_to_remove(view: MapView, config: BackendConfig) -> Rows:
    """Return the rows that leave the state: failed ones, the policy's choice, and what exceeds the cap.

    Landmarks out of view never use the capacity of new ones: without new landmarks the vehicle would have none to
    observe over new ground.
    """
    landmark_map = view.landmarks
    unseen = view.frame - landmark_map.seen
    removed = view.in_view & (unseen >= FAILED_AFTER_FRAMES) & (landmark_map.observations < ESTABLISHED_OBSERVATIONS)
    removed[RETENTION[config.retention](view, config)] = True
    out = np.flatnonzero(~removed & ~view.in_view)
    removed[_longest_unseen(landmark_map, out)[: max(0, len(out) - capacity_out_of_view(view, config))]] = True
    mature = np.flatnonzero(~removed & (view.frame - landmark_map.born >= YOUNG_FRAMES))
    surplus = max(0, int((~removed).sum()) - config.max_landmarks)
    removed[_longest_unseen(landmark_map, mature)[:surplus]] = True
    return np.flatnonzero(removed)


def capacity_out_of_view(view: MapView, config: BackendConfig) -> int:
    """Return the capacity left for landmarks out of view, after those in view and this frame's new ones."""
    return max(0, config.max_landmarks - int(view.in_view.sum()) - _new_landmarks(view, config))


def _new_landmarks(view: MapView, config: BackendConfig) -> int:
    """Return how many landmarks may be added in this frame."""
    return int(np.clip(config.max_in_view - int(view.in_view.sum()), 0, config.max_new_landmarks))


def _longest_unseen(landmark_map: LandmarkMap, rows: Rows) -> Rows:
    return rows[np.lexsort((landmark_map.observations[rows], landmark_map.seen[rows]))]
