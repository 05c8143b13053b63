# SPDX-License-Identifier: Apache-2.0
"""What stands on the ground: convex solids in closed form, each solid from its top surface down into the ground.

A line meets a convex solid in one interval, so that heights, views and shadows all follow from the same few formulas,
exactly.
"""

import enum
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Faces = NDArray[np.int8]
Bounds = tuple[float, float, float, float]  # west, south, east, north [m]


class Label(enum.IntEnum):
    """What is on top at a place."""

    GROUND = 0
    HEDGE = 1
    TREE = 2
    BARN = 3
    POST = 4


class Face(enum.IntEnum):
    """Part of a solid's surface; the walls are named along (A) and across (B) the ridge."""

    EAST_A = 0
    WEST_A = 1
    NORTH_B = 2
    SOUTH_B = 3
    ROOF_NORTH = 4
    ROOF_SOUTH = 5
    CROWN = 6
    SKIRT = 7


WALLS = (Face.EAST_A, Face.WEST_A, Face.NORTH_B, Face.SOUTH_B, Face.SKIRT)


class Solid(Protocol):
    """A convex solid that reaches down without end; the ground hides its foot."""

    @property
    def label(self) -> Label:
        """What it is."""
        ...

    @property
    def seed(self) -> int:
        """Of its look."""
        ...

    @property
    def foot_z(self) -> float:
        """A height below the ground all around [m]."""
        ...

    @property
    def bounds(self) -> Bounds:
        """Rectangle that contains it [m]."""
        ...

    @property
    def highest_z(self) -> float:
        """Height of its highest point [m]."""
        ...

    def top(self, x: Array, y: Array) -> Array:
        """Return the (N,) height of its top surface [m] at (N,) x, y [m]; -inf beside it."""
        ...

    def interval(self, origins: Array, directions: Array) -> tuple[Array, Array, Faces]:
        """Return the (N,) parameters at which lines enter and leave, and the face where they enter.

        Args:
            origins: (N, 3) or (3,) points [m].
            directions: (N, 3) or (3,) directions; a point of the line is origin + parameter * direction. A line that
                misses the solid enters after it leaves.
        """
        ...

    def normals(self, points: Array, faces: Faces) -> Array:
        """Return the (N, 3) outward unit normals at points on faces."""
        ...

    def chart(self, points: Array, faces: Faces) -> Array:
        """Return (N, 2) coordinates [m] of points along the surface, for its look."""
        ...
