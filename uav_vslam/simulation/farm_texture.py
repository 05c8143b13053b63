# SPDX-License-Identifier: Apache-2.0
"""The ground of a farm: fields with straight borders, tracks, cast shadows, and colours."""

from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from uav_vslam.simulation.farm import Farm
from uav_vslam.simulation.fields import places
from uav_vslam.simulation.shading import BRIGHTEST, SHADOW, Shadows, sunward, tint
from uav_vslam.simulation.texture import GRASS_OCTAVES, TILE, Grey, Texture, Tiled, hashed, noise_tile, octave, to_grey

Tint = NDArray[np.float32]

CROPS = (tint(60, 125, 85), tint(75, 115, 130), tint(80, 105, 130), tint(68, 122, 100), tint(64, 120, 112))
SOIL = tint(84, 108, 126)
GRASS = tint(68, 122, 98)
NEUTRAL = tint(1.0, 1.0, 1.0)
TRACK_WIDTH_M, RUT_M, RUT_WIDTH_M = 3.0, 0.8, 0.4
BORDER_WIDTH_M = 1.0  # of unmown grass on each side of a border
SOFT_M = 0.1  # over which a border or track fades
REACH_M = 15.0  # a shadow begins at most this high above the ground where it ends


class Tints(Protocol):
    """Colour of the ground."""

    def tints(self, column: int, row: int) -> Tint:
        """Return the (TILE, TILE, 3) BGR tints of a tile, or (3,) if they are the same all over."""
        ...


class FarmTexture(Tiled):
    """Grass and crops of many shades in fields with straight borders; tracks of bare soil."""

    def __init__(self, seed: int) -> None:
        super().__init__()
        self._seed = seed

    def _make_tile(self, column: int, row: int) -> Grey:
        plan = places(*texel_positions(column, row, self.m_per_px), self._seed)
        i, j = plan.field[..., 0], plan.field[..., 1]
        shade, density = 60.0 * (hashed(i, j, self._seed + 10) - 0.5), 0.8 + 0.5 * hashed(i, j, self._seed + 11)
        grass = noise_tile(GRASS_OCTAVES, column, row, self._seed + 20)
        clump, patch = (octave(spacing, column, row, self._seed + 30 + spacing) for spacing in (16, 64))
        grey = 105.0 + shade + density * grass + 18.0 * clump * patch
        grey -= 22.0 * _fade(BORDER_WIDTH_M - plan.border_m)
        soil = _fade(0.5 * TRACK_WIDTH_M - plan.track_m)
        rut = _fade(0.5 * RUT_WIDTH_M - np.abs(plan.track_m - RUT_M))
        grey += soil * (118.0 + 0.7 * grass - grey) + 22.0 * rut
        return to_grey(np.minimum(grey, np.floor(BRIGHTEST)))

    def tints(self, column: int, row: int) -> Tint:
        """Return the (TILE, TILE, 3) BGR tints of a tile."""
        plan = places(*texel_positions(column, row, self.m_per_px), self._seed)
        kind = hashed(plan.field[..., 0], plan.field[..., 1], self._seed + 12) * len(CROPS)
        soil = _fade(0.5 * TRACK_WIDTH_M - plan.track_m)[..., None]
        crop = np.array(CROPS)[kind.astype(int)]
        return np.asarray(crop + soil * (SOIL - crop), dtype=np.float32)


class PlainTint:
    """One tint all over."""

    def __init__(self, of_all: Tint) -> None:
        self._tint = of_all

    def tints(self, column: int, row: int) -> Tint:
        """Return the (3,) BGR tint."""
        return self._tint


class LitTexture(Tiled):
    """A grey ground with the shadows of what stands on it."""

    def __init__(self, ground: Texture, farm: Farm) -> None:
        super().__init__(ground.m_per_px)
        self._ground, self._farm = ground, farm

    def _make_tile(self, column: int, row: int) -> Grey:
        x0, y0 = column * TILE, row * TILE
        shadow = self._shadow(column, row)
        sunny = self._ground.window(x0, y0, x0 + TILE, y0 + TILE)
        return to_grey(np.minimum(sunny, np.floor(BRIGHTEST)) * (1.0 - (1.0 - SHADOW) * shadow))

    def _shadow(self, column: int, row: int) -> NDArray[np.float32]:
        """Return the share of each texel that is in the shade, softened by a texel as by the sun's width."""
        x, y = texel_positions(column, row, self.m_per_px, margin=1)
        z = self._farm.ground_z(x.astype(np.float32), y.astype(np.float32))
        bounds = float(x.min()), float(y.min()), float(x.max()), float(y.max())
        shadows = Shadows(self._farm.solids(sunward(bounds, REACH_M)))
        dark = shadows.fall_on(np.stack([x.ravel(), y.ravel(), z.ravel()], axis=-1)).reshape(x.shape)
        return np.asarray(cv2.blur(dark.astype(np.float32), (3, 3))[1:-1, 1:-1])


class ColourTexture(Tiled):
    """A grey ground in colour, BGR."""

    channels = (3,)

    def __init__(self, grey: Texture, tints: Tints) -> None:
        super().__init__(grey.m_per_px)
        self._grey, self._tints = grey, tints

    def _make_tile(self, column: int, row: int) -> Grey:
        x0, y0 = column * TILE, row * TILE
        grey = self._grey.window(x0, y0, x0 + TILE, y0 + TILE)
        return to_grey(grey[..., None] * self._tints.tints(column, row))


def texel_positions(
    column: int, row: int, m_per_px: float, *, margin: int = 0
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return x and y [m] of a tile's texels, (TILE, TILE) each, with `margin` more texels on all sides."""
    steps = np.arange(-margin, TILE + margin)
    x, y = np.meshgrid((column * TILE + steps) * m_per_px, (row * TILE + steps) * m_per_px)
    return x, y


def _fade(inside_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return 1 well inside, 0 outside, from the distance inside [m]."""
    return np.asarray(np.clip(inside_m / SOFT_M + 0.5, 0.0, 1.0))
