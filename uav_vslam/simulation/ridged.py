# SPDX-License-Identifier: Apache-2.0
"""Upright boxes under a ridge roof: barns, stretches of hedge, posts."""

from dataclasses import dataclass

import numpy as np

from uav_vslam.simulation.solids import Array, Bounds, Face, Faces, Label


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
        beside = (towards == 0.0) & (left < 0.0)  # parallel to a face, and outside it
        entering = np.where(beside, np.inf, np.where(towards < 0.0, crossing, -np.inf))
        leaving = np.where(beside, -np.inf, np.where(towards > 0.0, crossing, np.inf))
        return entering.max(axis=0), leaving.min(axis=0), entering.argmax(axis=0).astype(np.int8)

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
