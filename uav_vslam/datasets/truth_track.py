# SPDX-License-Identifier: Apache-2.0
"""The true motion of a recording, in stamp order."""

from array import array
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from uav_vslam.datasets.messages import TruthSample
from uav_vslam.types import NS_PER_S

Array = NDArray[np.float64]

NUMBERS = 15  # of a sample: position, velocity, rotation
SET_BACK_S, RUN = 0.5, 4  # least step back of a clock, and the steps before and after it that are forward and shorter
LEAST_DISPLACEMENT_M = 0.5  # within a second, with which velocities are compared: more than positions scatter by


@dataclass(frozen=True, slots=True)
class TruthTrack:
    """True motion, in stamp order.

    Attributes:
        stamps_ns: (N,) int64 [ns].
        positions_world: (N, 3) [m].
        R_world_body: (N, 3, 3).
        velocities_world: (N, 3) [m/s].
        left_out: messages without a usable pose.
        set_back: samples after the clock was set back: their stamps are those of earlier ones, so they are left out.
    """

    stamps_ns: NDArray[np.int64]
    positions_world: Array
    R_world_body: Array
    velocities_world: Array
    left_out: int = 0
    set_back: int = 0

    def __len__(self) -> int:
        return len(self.stamps_ns)

    @property
    def turns(self) -> bool:
        """Whether the orientation changes at all: sources of positions alone fill in the identity."""
        return len(self) > 0 and bool(np.ptp(self.R_world_body, axis=0).any())

    @property
    def speeds(self) -> Array:
        """(N-1,) mean speeds between poses [m/s]."""
        seconds = np.diff(self.stamps_ns) / NS_PER_S
        return np.asarray(np.linalg.norm(np.diff(self.positions_world, axis=0), axis=1) / seconds)


class TruthSeries:
    """Collects samples in any order, in arrays: 130 bytes each, where records take a kilobyte."""

    def __init__(self) -> None:
        self._stamps, self._numbers = array("q"), array("d")

    def add(self, sample: TruthSample) -> None:
        """Append a sample; one of the same stamp as an earlier one replaces it."""
        self._stamps.append(sample.stamp_ns)
        for values in (sample.T_world_body.t, sample.v_world, sample.T_world_body.R):
            self._numbers.extend(values.ravel().tolist())

    def __len__(self) -> int:
        return len(self._stamps)

    def track(self) -> TruthTrack:
        """Return all samples as a track.

        Velocities are differences where only poses were recorded, or a twist that contradicts them, such as one that
        was never filled in.
        """
        recorded = np.array(self._stamps, np.int64)
        stamps = recorded[: _until_set_back(recorded)]
        order = np.argsort(stamps, kind="stable")
        last = np.diff(stamps[order], append=np.iinfo(np.int64).max) != 0  # of those with the same stamp
        rows = np.array(self._numbers, float).reshape(-1, NUMBERS)[order[last]]
        set_back = len(recorded) - len(stamps)
        stamps, positions, velocities = stamps[order[last]], rows[:, 0:3], rows[:, 3:6]
        times_s = (stamps - stamps[:1]) / NS_PER_S
        if len(stamps) > 1 and (np.isnan(velocities).any() or _contradict(times_s, positions, velocities)):
            velocities = np.gradient(positions, times_s, axis=0)
        return TruthTrack(stamps, positions, rows[:, 6:].reshape(-1, 3, 3), velocities, set_back=set_back)


def _until_set_back(stamps_ns: NDArray[np.int64]) -> int:
    """Return how many of (N,) stamps, as recorded, come before the clock was set back; all if it was not.

    A single stamp that is wrong, or a few messages out of order, are no step of the clock.
    """
    steps = np.diff(stamps_ns)
    for k in np.flatnonzero(steps < -SET_BACK_S * NS_PER_S):
        around = np.concatenate([steps[max(0, k - RUN) : k], steps[k + 1 : k + 1 + RUN]])
        if len(around) == 2 * RUN and ((around > 0) & (around < -steps[k])).all():
            return int(k) + 1
    return len(stamps_ns)


def _contradict(times_s: Array, positions: Array, velocities: Array) -> bool:
    """Return whether velocities account for less than half of the displacement within a second, in the median.

    Args:
        times_s: (N,) rising times [s].
        positions, velocities: (N, 3) [m], [m/s].
    """
    steps = 0.5 * (velocities[1:] + velocities[:-1]) * np.diff(times_s)[:, None]
    by_velocity = np.vstack([np.zeros(3), np.cumsum(steps, axis=0)])
    later = np.searchsorted(times_s, times_s + 1.0)
    first = np.flatnonzero(later < len(times_s))
    if len(first) == 0:
        first, later = np.zeros(1, np.intp), np.full(1, len(times_s) - 1)
    displacement = positions[later[first]] - positions[first]
    missed = np.linalg.norm(displacement - (by_velocity[later[first]] - by_velocity[first]), axis=1)
    displacement_m = np.linalg.norm(displacement, axis=1)
    return bool(
        np.median(displacement_m) > LEAST_DISPLACEMENT_M and np.median(missed) > 0.5 * np.median(displacement_m)
    )
