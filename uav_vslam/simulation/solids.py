# SPDX-License-Identifier: Apache-2.0
"""What stands on the ground: convex solids in closed form, each solid from its top surface down into the ground.

A line meets a convex solid in one interval, so that heights, views and shadows all follow from the same few formulas,
exactly.
"""

import enum
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Faces = NDArray[np.int8]
Bounds = tuple[float, float, float, float]  # west, south, east, north [m]

TINY = 1e-12  # squared horizontal length below which a direction counts as vertical


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


@dataclass(frozen=True, slots=True)
class Ridged:
    """An upright box under a ridge roof: a barn, a stretch of hedge, or, without pitch, a post.

    Attributes:
        label, seed, foot_z: as in `Solid`.
        x, y: centre [m].
        heading_rad: of the ridge, from east to north.
        length_m, width_m: along and across the ridge.
        ridge_z: height of the ridge at the centre [m].
        pitch: fall of the roof per metre away from the ridge.
        climb: rise of ridge and eaves per metre along the ridge.
    """

    label: Label
    seed: int
    foot_z: float
    x: float
    y: float
    heading_rad: float
    length_m: float
    width_m: float
    ridge_z: float
    pitch: float
    climb: float = 0.0

    @property
    def bounds(self) -> Bounds:
        """Rectangle that contains it [m]."""
        (west, south), (east, north) = self.footprint.min(axis=0), self.footprint.max(axis=0)
        return float(west), float(south), float(east), float(north)

    @property
    def highest_z(self) -> float:
        """Height of its highest point [m]."""
        return self.ridge_z + 0.5 * self.length_m * abs(self.climb)

    @property
    def footprint(self) -> Array:
        """(4, 2) corners [m], counter-clockwise."""
        a, b = 0.5 * self.length_m * np.array([1, -1, -1, 1]), 0.5 * self.width_m * np.array([1, 1, -1, -1])
        return np.stack([a, b], axis=-1) @ self._axes + [self.x, self.y]

    @property
    def roof_corners(self) -> Array:
        """(6, 3) corners of the roof [m]: the eaves above the footprint's corners, then the ends of the ridge."""
        ridge = 0.5 * self.length_m * np.array([[1.0], [-1.0]]) * self._axes[0] + [self.x, self.y]
        xy = np.concatenate([self.footprint, ridge])
        a, b = self._local(xy)
        return np.column_stack([xy, self.ridge_z + self.climb * a - self.pitch * np.abs(b)])

    @property
    def _axes(self) -> Array:
        """(2, 2) unit vectors along and across the ridge, as rows."""
        c, s = np.cos(self.heading_rad), np.sin(self.heading_rad)
        return np.array([[c, s], [-s, c]])

    def _local(self, xy: Array) -> tuple[Array, Array]:
        a, b = ((xy - [self.x, self.y]) @ self._axes.T).T
        return a, b

    @property
    def _planes(self) -> tuple[Array, Array]:
        """(6, 3) normals n, one row a face, and (6,) offsets c of the half-spaces n . (p - centre) <= c."""
        along, across = self._axes
        walls = [np.append(n, 0.0) for n in (along, -along, across, -across)]
        roof = [np.append(sign * self.pitch * across - self.climb * along, 1.0) for sign in (1.0, -1.0)]
        half = 0.5 * np.array([self.length_m, self.length_m, self.width_m, self.width_m])
        return np.array(walls + roof), np.append(half, [0.0, 0.0])

    def top(self, x: Array, y: Array) -> Array:
        """Return the (N,) height of its top surface [m] at (N,) x, y [m]; -inf beside it."""
        a, b = self._local(np.column_stack([x, y]))
        inside = (np.abs(a) <= 0.5 * self.length_m) & (np.abs(b) <= 0.5 * self.width_m)
        return np.where(inside, self.ridge_z + self.climb * a - self.pitch * np.abs(b), -np.inf)

    def interval(self, origins: Array, directions: Array) -> tuple[Array, Array, Faces]:
        """Return the (N,) parameters at which lines enter and leave, and the face where they enter."""
        normals, offsets = self._planes
        left = offsets[:, None] - normals @ np.atleast_2d(origins - [self.x, self.y, self.ridge_z]).T
        left, towards = np.broadcast_arrays(left, normals @ np.atleast_2d(directions).T)  # (6, N)
        with np.errstate(divide="ignore", invalid="ignore"):
            crossing = left / towards
        entering = np.where(towards < 0.0, crossing, -np.inf)
        entering[(towards == 0.0) & (left < 0.0)] = np.inf  # parallel and outside
        faces = entering.argmax(axis=0)
        return entering.max(axis=0), np.where(towards > 0.0, crossing, np.inf).min(axis=0), faces.astype(np.int8)

    def normals(self, points: Array, faces: Faces) -> Array:
        """Return the (N, 3) outward unit normals at points on faces."""
        normals = self._planes[0]
        normals = normals / np.linalg.norm(normals, axis=1, keepdims=True)
        return np.asarray(normals[faces])

    def chart(self, points: Array, faces: Faces) -> Array:
        """Return (N, 2) coordinates [m]: along walls and upwards, or along and across the ridge."""
        a, b = self._local(points[:, :2])
        a = a + np.dot([self.x, self.y], self._axes[0])  # goes on in the next piece of a hedge
        first = np.where(faces <= Face.WEST_A, b + self.length_m, a)
        return np.column_stack([first, np.where(faces <= Face.SOUTH_B, points[:, 2] - self.ridge_z, b)])


@dataclass(frozen=True, slots=True)
class Dome:
    """A round column under half an ellipsoid: a tree's crown, or part of it.

    Attributes:
        label, seed, foot_z: as in `Solid`.
        x, y: centre [m].
        radius_m: of the column.
        rim_z: height of the rim, where the dome begins [m].
        rise_m: height of the dome over its rim.
    """

    label: Label
    seed: int
    foot_z: float
    x: float
    y: float
    radius_m: float
    rim_z: float
    rise_m: float

    @property
    def bounds(self) -> Bounds:
        """Rectangle that contains it [m]."""
        return self.x - self.radius_m, self.y - self.radius_m, self.x + self.radius_m, self.y + self.radius_m

    @property
    def highest_z(self) -> float:
        """Height of its highest point [m]."""
        return self.rim_z + self.rise_m

    def top(self, x: Array, y: Array) -> Array:
        """Return the (N,) height of its top surface [m] at (N,) x, y [m]; -inf beside it."""
        left = 1.0 - ((x - self.x) ** 2 + (y - self.y) ** 2) / self.radius_m**2
        return np.where(left >= 0.0, self.rim_z + self.rise_m * np.sqrt(np.maximum(left, 0.0)), -np.inf)

    def interval(self, origins: Array, directions: Array) -> tuple[Array, Array, Faces]:
        """Return the (N,) parameters at which lines enter and leave, and the face where they enter."""
        scale = np.array([self.radius_m, self.radius_m, self.rise_m])
        o = np.atleast_2d((origins - [self.x, self.y, self.rim_z]) / scale).T
        d = np.atleast_2d(directions / scale).T
        c1, c2 = _unit_roots(o[:2], d[:2])
        e1, e2 = _unit_roots(o, d)
        with np.errstate(invalid="ignore"):  # a vertical line is inside the column from -inf to inf
            low1, low2 = o[2] + c1 * d[2] <= 0.0, o[2] + c2 * d[2] <= 0.0
        missed = c1 > c2
        t_in = np.where(missed, np.inf, np.where(low1, c1, e1))
        t_out = np.where(missed, -np.inf, np.where(low2, c2, e2))
        return t_in, t_out, np.where(low1, Face.SKIRT, Face.CROWN).astype(np.int8)

    def normals(self, points: Array, faces: Faces) -> Array:
        """Return the (N, 3) outward unit normals at points on faces."""
        n = (points - [self.x, self.y, self.rim_z]) / np.array([self.radius_m, self.radius_m, self.rise_m]) ** 2
        n[faces == Face.SKIRT, 2] = 0.0
        return np.asarray(n / np.linalg.norm(n, axis=1, keepdims=True))

    def chart(self, points: Array, faces: Faces) -> Array:
        """Return (N, 2) coordinates [m]: a slanted view, so that neither crown nor skirt is a smear."""
        x, y, z = (points - [self.x, self.y, self.rim_z]).T
        return np.column_stack([x + 0.7 * z, y - 0.6 * z])


def _unit_roots(o: Array, d: Array) -> tuple[Array, Array]:
    """Return the (N,) parameters at which lines o + t d, (2 or 3, N), enter and leave the unit ball.

    They are inf and -inf for a line that misses it. A direction of no length is inside from -inf to inf, or misses.
    """
    aa, ab, oo = np.maximum(_dot(d, d), TINY), _dot(o, d), _dot(o, o)
    rest = ab * ab - aa * (oo - 1.0)
    root = np.sqrt(np.maximum(rest, 0.0))
    hit = rest >= 0.0
    return np.where(hit, (-ab - root) / aa, np.inf), np.where(hit, (root - ab) / aa, -np.inf)


def _dot(a: Array, b: Array) -> Array:
    """Return the (N,) products of columns."""
    return np.asarray(sum(p * q for p, q in zip(a, b, strict=True)))
