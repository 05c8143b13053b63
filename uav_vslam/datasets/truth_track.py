# SPDX-License-Identifier: Apache-2.0
"""The true motion of a recording, in stamp order."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from uav_vslam.datasets.messages import TruthSample
from uav_vslam.types import NS_PER_S

Array = NDArray[np.float64]

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
    """

    stamps_ns: NDArray[np.int64]
    positions_world: Array
    R_world_body: Array
    velocities_world: Array
    left_out: int = 0

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


def truth_track(samples: list[TruthSample]) -> TruthTrack:
    """Return samples in any order as a track.

    Velocities are differences where only poses were recorded, or a twist that contradicts them, such as one that was
    never filled in.
    """
    if not samples:
        return TruthTrack(np.zeros(0, np.int64), np.zeros((0, 3)), np.zeros((0, 3, 3)), np.zeros((0, 3)))
    samples = sorted({sample.stamp_ns: sample for sample in samples}.values(), key=lambda s: s.stamp_ns)
    stamps = np.array([s.stamp_ns for s in samples], dtype=np.int64)
    positions = np.array([s.T_world_body.t for s in samples])
    velocities = np.array([s.v_world for s in samples])
    times_s = (stamps - stamps[0]) / NS_PER_S
    if len(samples) > 1 and (np.isnan(velocities).any() or _contradict(times_s, positions, velocities)):
        velocities = np.gradient(positions, times_s, axis=0)
    return TruthTrack(stamps, positions, np.array([s.T_world_body.R for s in samples]), velocities)


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
