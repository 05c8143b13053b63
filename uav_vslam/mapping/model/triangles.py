# SPDX-License-Identifier: Apache-2.0
"""Triangles over a grid of heights, with upright walls where it jumps.

Each cell is a quadrilateral. Around a corner of the grid, cells whose heights differ by less than a jump share a
vertex, at their mean height; across a jump each side keeps its own, and a wall stands between them.
"""

from dataclasses import dataclass

import fast_simplification
import numpy as np
from numpy.typing import NDArray

from uav_vslam.mapping.raster import Raster

Array = NDArray[np.float64]
Index = NDArray[np.int64]

JUMP_M = 1.0  # between neighbouring cells
STEEP = 0.35  # vertical part of the unit normal below which a triangle is a wall


@dataclass(frozen=True, slots=True)
class Mesh:
    """Triangles in the map frame.

    Attributes:
        vertices: (V, 3) [m].
        faces: (F, 3) indices of vertices, counter-clockwise from outside.
    """

    vertices: Array
    faces: Index

    @property
    def normals(self) -> Array:
        """(F, 3) unit normals of the faces, 0 for one without area."""
        a, b, c = (self.vertices[self.faces[:, k]] for k in range(3))
        cross = np.cross(b - a, c - a)
        return np.asarray(cross / np.maximum(np.linalg.norm(cross, axis=1, keepdims=True), 1e-12))

    @property
    def steep(self) -> NDArray[np.bool_]:
        """(F,) which faces are walls."""
        return np.asarray(np.abs(self.normals[:, 2]) < STEEP)

    def part(self, chosen: NDArray[np.bool_]) -> "Mesh":
        """Return the (F,) chosen faces and the vertices they need."""
        used, faces = np.unique(self.faces[chosen], return_inverse=True)
        return Mesh(self.vertices[used], faces.reshape(-1, 3))


def mesh_of(heights: NDArray[np.floating], raster: Raster) -> Mesh:
    """Return the triangles of (rows, columns) heights [m]; none where they are NaN."""
    cells = _around_corners(np.pad(heights.astype(float), 1, constant_values=np.nan))
    groups = _groups(cells)
    level = np.stack([_group_mean(cells, groups, k) for k in range(4)])
    corner = np.arange(groups[0].size).reshape(groups[0].shape)
    known = np.isfinite(cells)
    keys = np.where(known, 4 * corner + groups, -1)
    used, first, compact = np.unique(keys, return_index=True, return_inverse=True)
    index = compact.reshape(keys.shape) - (1 if used[0] < 0 else 0)
    row, column = np.divmod(used[used >= 0] // 4, raster.columns + 1)
    west, south, _, _ = raster.bounds_m
    z = level.ravel()[first[used >= 0]]
    vertices = np.stack([west + column * raster.cell_m, south + row * raster.cell_m, z], axis=1)
    return Mesh(vertices, _faces(index, np.isfinite(heights)))


def simplified(mesh: Mesh, triangles: int) -> Mesh:
    """Return the mesh with about this many triangles, fewest where it is even (quadric error)."""
    if len(mesh.faces) <= triangles:
        return mesh
    centre = mesh.vertices.mean(axis=0)
    points, faces = fast_simplification.simplify(
        (mesh.vertices - centre).astype(np.float32), mesh.faces.astype(np.int32), target_count=triangles
    )
    return Mesh(points.astype(float) + centre, faces.astype(np.int64))


def _around_corners(padded: Array) -> Array:
    """Return (4, rows + 1, columns + 1) heights of the cells SW, SE, NE, NW of each corner."""
    return np.stack([padded[:-1, :-1], padded[:-1, 1:], padded[1:, 1:], padded[1:, :-1]])


def _groups(cells: Array) -> Index:
    """Return (4, …) the lowest number of a cell around the same corner that each one is joined with."""
    with np.errstate(invalid="ignore"):
        joined = np.abs(cells - np.roll(cells, -1, axis=0)) < JUMP_M  # each with the next around the corner
    groups = np.broadcast_to(np.arange(4)[:, None, None], cells.shape).copy()
    for _ in range(3):
        following = np.where(joined, np.minimum(groups, np.roll(groups, -1, axis=0)), groups)
        groups = np.where(np.roll(joined, 1, axis=0), np.minimum(following, np.roll(following, 1, axis=0)), following)
    return groups


def _group_mean(cells: Array, groups: Index, k: int) -> Array:
    same = (groups == groups[k]) & np.isfinite(cells)
    return np.asarray(np.where(same, cells, 0.0).sum(axis=0) / np.maximum(same.sum(axis=0), 1))


def _faces(index: Index, known: NDArray[np.bool_]) -> Index:
    """Return (F, 3) faces of the cells and of the walls between them.

    Args:
        index: (4, rows + 1, columns + 1) vertex of the cells around each corner.
        known: (rows, columns) which cells there are.
    """
    sw, se, ne, nw = index[2, :-1, :-1], index[3, :-1, 1:], index[0, 1:, 1:], index[1, 1:, :-1]
    tops = _quadrilaterals(sw, se, ne, nw, known)
    east = _quadrilaterals(se[:, :-1], sw[:, 1:], nw[:, 1:], ne[:, :-1], known[:, :-1] & known[:, 1:])
    north = _quadrilaterals(nw[:-1], ne[:-1], se[1:], sw[1:], known[:-1] & known[1:])
    faces = np.concatenate([tops, east, north])
    a, b, c = faces.T
    return np.asarray(faces[(a != b) & (b != c) & (c != a)])


def _quadrilaterals(a: Index, b: Index, c: Index, d: Index, chosen: NDArray[np.bool_]) -> Index:
    a, b, c, d = (corner[chosen] for corner in (a, b, c, d))
    return np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
