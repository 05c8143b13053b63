# SPDX-License-Identifier: Apache-2.0
"""The plan of a farm: an unbounded net of four-sided fields with straight borders; every other row of them is a track.

Corner (i, j) of the net lies near (i, j) * FIELD_M; field (i, j) is north-east of it. The corner's place and the
field's look depend on i, j and the seed alone.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from uav_vslam.simulation.texture import hashed

Array = NDArray[np.float64]

FIELD_M = 90.0
ON_BORDER_M = 1e-9  # so that no place falls between two fields
JITTER = 0.2  # of corners, in field sizes; below 0.25 all fields are convex


@dataclass(frozen=True, slots=True)
class Places:
    """What the plan has at each of some places.

    Attributes:
        field: (..., 2) int64 i, j.
        border_m: distance to the nearest border of the field that is no track [m].
        track_m: distance to the middle of the nearest track [m], inf beyond the field.
    """

    field: NDArray[np.int64]
    border_m: Array
    track_m: Array


def corner(i: NDArray[np.int64] | int, j: NDArray[np.int64] | int, seed: int) -> Array:
    """Return (..., 2) positions of corners [m]."""
    i, j = np.asarray(i), np.asarray(j)
    shift = JITTER * (2.0 * np.stack([hashed(i, j, seed), hashed(i, j, seed + 1)], axis=-1) - 1.0)
    return np.asarray(FIELD_M * (np.stack([i, j], axis=-1) + shift))


def outline(i: int, j: int, seed: int) -> Array:
    """Return the (4, 2) corners of a field [m], counter-clockwise from the south-west."""
    return np.array([corner(i + di, j + dj, seed) for di, dj in ((0, 0), (1, 0), (1, 1), (0, 1))])


def is_track(j: int) -> bool:
    """Return whether the southern border of the fields of row j is a track."""
    return j % 2 == 0


def places(x: Array, y: Array, seed: int) -> Places:
    """Return the plan at x, y [m] of equal shape; one of no size has no fields."""
    found = Places(np.zeros((*x.shape, 2), np.int64), np.full(x.shape, np.inf), np.full(x.shape, np.inf))
    if x.size == 0:
        return found
    (i0, i1), (j0, j1) = (
        (int(np.floor(v.min() / FIELD_M - JITTER)) - 1, int(np.floor(v.max() / FIELD_M + JITTER)) + 1) for v in (x, y)
    )
    for j in range(j0, j1 + 1):
        for i in range(i0, i1 + 1):
            _fill(found, (i, j), x, y, seed)
    return found


def _fill(found: Places, field: tuple[int, int], x: Array, y: Array, seed: int) -> None:
    """Enter the places that are in one field."""
    corners = outline(*field, seed)
    (west, south), (east, north) = corners.min(axis=0), corners.max(axis=0)
    if west > x.max() or east < x.min() or south > y.max() or north < y.min():
        return
    inward = np.stack([_left_of(corners[k], corners[(k + 1) % 4], x, y) for k in range(4)])
    inside = (inward >= -ON_BORDER_M).all(axis=0)
    tracks = np.array([is_track(field[1]), False, is_track(field[1] + 1), False])
    found.field[inside] = field
    found.border_m[inside] = inward[~tracks].min(axis=0)[inside]
    found.track_m[inside] = inward[tracks].min(axis=0)[inside]


def _left_of(start: Array, end: Array, x: Array, y: Array) -> Array:
    """Return the distance of x, y to the left of the line from start to end [m]."""
    dx, dy = (end - start) / np.linalg.norm(end - start)
    return np.asarray(dx * (y - start[1]) - dy * (x - start[0]))
