# SPDX-License-Identifier: Apache-2.0
"""Round columns under half an ellipsoid: crowns of trees."""

from dataclasses import dataclass

import numpy as np

from uav_vslam.simulation.solids import Array, Bounds, Face, Faces, Label

TINY = 1e-12  # squared horizontal length below which a direction counts as vertical


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
        return np.column_stack([x + 0.25 * z, y - 0.2 * z])


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
