# SPDX-License-Identifier: Apache-2.0
"""How bright and of which colour solids are: a fixed sun, the light of the sky, and a look for each material.

A grey value is the luminance (ITU-R BT.601) of the colour: colour = grey * tint, where a tint has luminance 1.
"""

import functools
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from uav_vslam.simulation.solids import WALLS, Bounds, Faces, Label, Solid
from uav_vslam.simulation.texture import noise_tile

Array = NDArray[np.float64]
Grey = NDArray[np.float32]

TO_SUN = np.array([0.5, -0.5, np.sqrt(0.5)])  # unit vector, 45 degrees high in the south-east: shadows as long as high
SHADOW = 0.45  # brightness in the shade, relative to level ground in the sun
GREATEST_TINT = 1.28
BRIGHTEST = 255.0 / GREATEST_TINT  # grey level whose colours fit into 8 bits
LUMINANCE = np.array([0.114, 0.587, 0.299], np.float32)  # of blue, green, red

LOOK_M_PER_PX = 0.05
LOOK_OCTAVES = ((2, 10.0), (4, 12.0), (8, 12.0), (16, 8.0), (64, 6.0))
SHEET_M = 0.9  # width of a corrugated sheet on a roof, and
PLANK_M = 0.35  # of a plank in a wall
CLEAR_M = 1e-4  # from its surface, where the way of a point to the sun begins


def tint(blue: float, green: float, red: float) -> Grey:
    """Return the (3,) tint of a colour.

    Raises:
        ValueError: it is so strong that bright greys would not fit into 8 bits.
    """
    bgr = np.array([blue, green, red], np.float32)
    of_one = bgr / (bgr @ LUMINANCE)
    if of_one.max() > GREATEST_TINT:
        raise ValueError(f"tint {of_one} exceeds {GREATEST_TINT}: choose a weaker colour")
    return np.asarray(of_one)


ROOFS = (tint(85, 95, 135), tint(128, 118, 108), tint(100, 108, 120), tint(95, 104, 132))
LEAVES = (tint(55, 120, 80), tint(60, 120, 95), tint(72, 120, 76))
WOOD, RENDER = tint(78, 106, 130), tint(108, 118, 120)


def light(normals: Array) -> Grey:
    """Return (N,) brightness of surfaces with (N, 3) unit normals in the sun, relative to level ground."""
    facing = np.maximum(normals @ TO_SUN, 0.0) / TO_SUN[2]
    return (SHADOW + (1.0 - SHADOW) * facing).astype(np.float32)


class Shadows:
    """The shadows of some solids."""

    def __init__(self, solids: list[Solid]) -> None:
        self._solids = solids
        self._bounds = np.array([solid.bounds for solid in solids]).reshape(-1, 4)
        self._highest = np.array([solid.highest_z for solid in solids])

    def fall_on(self, points: Array, *, but_of: Solid | None = None) -> NDArray[np.bool_]:
        """Return whether a solid, other than `but_of`, keeps the sun away from (N, 3) points [m]."""
        dark = np.zeros(len(points), bool)
        for solid, bounds in self._near(points):
            rows = np.flatnonzero(~dark & _within(points, bounds) & (points[:, 2] < solid.highest_z))
            if len(rows) and solid is not but_of:
                t_in, t_out, _ = solid.interval(points[rows], TO_SUN)
                dark[rows] = t_out > np.maximum(t_in, CLEAR_M)
        return dark

    def _near(self, points: Array) -> Iterator[tuple[Solid, Bounds]]:
        """Yield the solids whose shadow may reach some of the points, and the shadow's bounds."""
        if len(points) == 0 or not self._solids:
            return
        low, high = points.min(axis=0), points.max(axis=0)
        shift = -TO_SUN[:2] / TO_SUN[2] * np.maximum(self._highest - low[2], 0.0)[:, None]
        bounds = self._bounds + np.concatenate([np.minimum(shift, 0.0), np.maximum(shift, 0.0)], axis=1)
        for k in np.flatnonzero((bounds[:, :2] <= high[:2]).all(axis=1) & (bounds[:, 2:] >= low[:2]).all(axis=1)):
            west, south, east, north = bounds[k]
            yield self._solids[k], (west, south, east, north)


def shade(solid: Solid, points: Array, faces: Faces, shadows: Shadows) -> Grey:
    """Return the (N,) grey levels of (N, 3) points on faces of a solid in sun and shadows."""
    brightness = light(solid.normals(points, faces))
    rows = np.flatnonzero(brightness > SHADOW)
    brightness[rows[shadows.fall_on(points[rows], but_of=solid)]] = SHADOW
    return np.clip(_look(solid, points, faces) * brightness, 0.0, np.float32(BRIGHTEST))


def sunward(bounds: Bounds, height_m: float) -> Bounds:
    """Return a rectangle that contains all whose shadow, from up to `height_m` above, can fall into a rectangle."""
    west, south, east, north = bounds
    dx, dy = TO_SUN[:2] / TO_SUN[2] * height_m
    return west + min(dx, 0.0), south + min(dy, 0.0), east + max(dx, 0.0), north + max(dy, 0.0)


def tints(solid: Solid, faces: Faces) -> Grey:
    """Return the (N, 3) BGR tints of faces of a solid."""
    top = {Label.BARN: ROOFS[solid.seed % len(ROOFS)], Label.POST: WOOD}.get(
        solid.label, LEAVES[solid.seed % len(LEAVES)]
    )
    wall = {Label.BARN: (WOOD, RENDER)[solid.seed % 2]}.get(solid.label, top)
    return np.where(np.isin(faces, WALLS)[:, None], wall, top)


def _look(solid: Solid, points: Array, faces: Faces) -> Grey:
    """Return (N,) grey levels in full light."""
    along, up = solid.chart(points, faces).T
    noise = _noise(along, up, solid.seed)
    shift = float(solid.seed % 97) / 96.0
    if solid.label in (Label.HEDGE, Label.TREE):
        return 95.0 + 20.0 * np.float32(shift) + 1.4 * noise
    walls = np.isin(faces, WALLS)
    grooves = np.cos(2.0 * np.pi * along / np.where(walls, PLANK_M, SHEET_M)).astype(np.float32)
    return np.where(walls, 105.0 + 50.0 * (1.0 - shift), 95.0 + 60.0 * shift).astype(np.float32) + (
        8.0 * np.maximum(grooves, 0.0) ** 4 + 0.9 * noise
    )


def _noise(u: Array, v: Array, seed: int) -> Grey:
    """Return smooth noise at (N,) coordinates [m]; each seed has its own place in one picture."""
    start = np.random.default_rng(seed).uniform(0.0, 25.0, 2)
    at = (np.stack([v, u]) + start[:, None]) / LOOK_M_PER_PX
    return np.asarray(map_coordinates(_noise_picture(), at, order=1, mode="mirror"))


@functools.cache
def _noise_picture() -> Grey:
    return noise_tile(LOOK_OCTAVES, 0, 0, 0)


def _within(points: Array, bounds: Bounds) -> NDArray[np.bool_]:
    west, south, east, north = bounds
    x, y = points[:, 0], points[:, 1]
    return np.asarray((x >= west) & (x <= east) & (y >= south) & (y <= north))
