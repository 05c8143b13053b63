# SPDX-License-Identifier: Apache-2.0
"""The top surface of ground and solids at any places: the truth for height maps and orthophotos."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from uav_vslam.simulation.farm import Farm, Heights
from uav_vslam.simulation.farm_texture import REACH_M
from uav_vslam.simulation.shading import Shadows, shade, sunward, tints
from uav_vslam.simulation.solids import Bounds, Label, Solid
from uav_vslam.simulation.texture import Texture

Array = NDArray[np.float64]
Pixels = NDArray[np.float32]

BLOCK_M = 32.0  # places are dealt with in squares of this size, each with the few solids that stand there
DOWN = np.array([0.0, 0.0, -1.0])


@dataclass(frozen=True, slots=True)
class Tops:
    """The top surface at some places.

    Attributes:
        z: (...) heights [m].
        labels: (...) uint8 `Label`.
    """

    z: Array
    labels: NDArray[np.uint8]


def tops(farm: Farm | None, ground_z: Heights, x: Array, y: Array) -> Tops:
    """Return what is on top at world positions x, y [m] of equal shape; no farm is bare ground."""
    x, y = np.asarray(x, float), np.asarray(y, float)
    z = np.asarray(ground_z(x.ravel(), y.ravel()), dtype=float)
    labels = np.zeros(z.shape, np.uint8)
    for rows, solids in _blocks(farm, x.ravel(), y.ravel()):
        z[rows], which = highest(solids, z[rows], x.ravel()[rows], y.ravel()[rows])
        labels[rows] = np.array([*(solid.label for solid in solids), Label.GROUND], np.uint8)[which]
    return Tops(z.reshape(x.shape), labels.reshape(x.shape))


def highest(solids: list[Solid], ground_z: Array, x: Array, y: Array) -> tuple[Array, NDArray[np.intp]]:
    """Return the (N,) heights of the top surface at (N,) x, y, and the index of the solid there, -1 for the ground."""
    z, which = ground_z.copy(), np.full(len(x), -1)
    for k, solid in enumerate(solids):
        west, south, east, north = solid.bounds
        rows = np.flatnonzero((x >= west) & (x <= east) & (y >= south) & (y <= north))
        top = solid.top(x[rows], y[rows])
        above = top > z[rows]
        z[rows[above]], which[rows[above]] = top[above], k
    return z, which


def picture(
    farm: Farm | None, ground_z: Heights, texture: Texture, x: Array, y: Array, *, colour: bool
) -> NDArray[np.float32]:
    """Return (...) grey levels, or (..., 3) BGR, seen from straight above at x, y [m], with cast shadows.

    Args:
        farm: what stands on the ground.
        ground_z: its height.
        texture: the ground with shadows, grey or BGR as `colour` says.
        x, y: world positions [m] of equal shape.
        colour: of what stands on the ground.
    """
    x, y = np.asarray(x, float), np.asarray(y, float)
    flat_x, flat_y = x.ravel(), y.ravel()
    out = np.zeros((x.size, 3) if colour else x.size, np.float32)
    for rows in _squares(flat_x, flat_y):
        out[rows] = sample(texture, flat_x[rows], flat_y[rows])
    z = np.asarray(ground_z(flat_x, flat_y), dtype=float)
    for rows, solids in _blocks(farm, flat_x, flat_y, reach_m=REACH_M):
        top, which = highest(solids, z[rows], flat_x[rows], flat_y[rows])
        points, shadows = np.column_stack([flat_x[rows], flat_y[rows], top]), Shadows(solids)
        for k in np.unique(which[which >= 0]):
            mine = which == k
            _, _, faces = solids[k].interval(points[mine] - DOWN, DOWN)
            grey = shade(solids[k], points[mine], faces, shadows)
            out[rows[mine]] = grey[:, None] * tints(solids[k], faces) if colour else grey
    return out.reshape((*x.shape, 3) if colour else x.shape)


def sample(texture: Texture, x: Array, y: Array) -> Pixels:
    """Return the (N,) or (N, 3) values of a texture at (N,) positions near each other [m], linearly interpolated."""
    at = np.stack([y, x]) / texture.m_per_px
    low, high = np.floor(at.min(axis=1)).astype(int), np.floor(at.max(axis=1)).astype(int) + 2
    window = texture.window(int(low[1]), int(low[0]), int(high[1]), int(high[0]))
    planes = window[..., None] if window.ndim == 2 else window
    at -= low[:, None]
    values = [map_coordinates(planes[..., c], at, np.float32, order=1) for c in range(planes.shape[-1])]
    return np.stack(values, axis=-1) if window.ndim == 3 else values[0]


def _blocks(
    farm: Farm | None, x: Array, y: Array, *, reach_m: float = 0.0
) -> Iterator[tuple[NDArray[np.intp], list[Solid]]]:
    """Yield rows of places and what stands there, or, within `reach_m` of height, between there and the sun."""
    if farm is None:
        return
    for rows in _squares(x, y):
        bounds: Bounds = float(x[rows].min()), float(y[rows].min()), float(x[rows].max()), float(y[rows].max())
        solids = farm.solids(sunward(bounds, reach_m))
        if solids:
            yield rows, solids


def _squares(x: Array, y: Array) -> Iterator[NDArray[np.intp]]:
    """Yield the rows of places square by square."""
    if len(x) == 0:
        return
    i, j = np.floor(x / BLOCK_M).astype(np.int64), np.floor(y / BLOCK_M).astype(np.int64)
    square = (i - i.min()) * (j.max() - j.min() + 1) + j - j.min()
    order = np.argsort(square, kind="stable")
    yield from np.split(order, np.flatnonzero(np.diff(square[order])) + 1)
