# SPDX-License-Identifier: Apache-2.0
"""Ground texture: grey tiles, generated on first use, that never repeat.

Texel (row i, column j) of the unbounded texture has its centre at world x = j * m_per_px, y = i * m_per_px. Noise comes
from a hash of lattice coordinates, so tiles fit together without a seam, in any order of generation.
"""

import functools
from collections import OrderedDict
from pathlib import Path
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from uav_vslam.errors import ConfigError

TEXEL_M = 0.05  # side of a texel on the ground
TILE = 512  # texels along the side of a tile
KEPT_TILES = 256  # 64 MB
MAX_WINDOW_TEXELS = 100_000_000

# Finest lattice first: spacing in texels (a power of two, at most TILE) and amplitude in grey levels.
GRASS_OCTAVES = ((2, 15.0), (4, 13.0), (8, 11.0), (16, 8.0), (32, 6.0), (64, 5.0), (256, 5.0), (512, 6.0))
DETAIL_OCTAVES = ((2, 7.0), (4, 7.0), (8, 5.0))  # added to pictures, so that repeated ones differ
FIELD_SIZE_M = 90.0
HEDGE_WIDTH_M = 1.5
TRACK_SPACING_M = 150.0
FIELD_STEP = 8  # fields and tracks are drawn on a grid of this many texels and interpolated
IMAGE_SUFFIXES = {".jpg", ".jpeg", ".png", ".bmp", ".tif", ".tiff"}

Grey = NDArray[np.uint8]
Noise = NDArray[np.float32]


class Texture(Protocol):
    """A picture of the whole ground, grey or BGR."""

    m_per_px: float

    def window(self, x0: int, y0: int, x1: int, y1: int) -> Grey:
        """Return the (y1 - y0, x1 - x0) texels of columns x0..x1-1 and rows y0..y1-1; BGR ones have 3 channels."""
        ...


class Tiled:
    """Cuts windows from a cache of tiles."""

    channels: tuple[int, ...] = ()  # (3,) for BGR

    def __init__(self, m_per_px: float = TEXEL_M) -> None:
        self.m_per_px = m_per_px
        self._tiles: OrderedDict[tuple[int, int], Grey] = OrderedDict()

    def _make_tile(self, column: int, row: int) -> Grey:
        raise NotImplementedError

    def window(self, x0: int, y0: int, x1: int, y1: int) -> Grey:
        """Return the (y1 - y0, x1 - x0) texels of columns x0..x1-1 and rows y0..y1-1."""
        if (x1 - x0) * (y1 - y0) > MAX_WINDOW_TEXELS:
            raise ConfigError(
                f"a camera sees {x1 - x0} x {y1 - y0} texels of ground: it sees (almost) the horizon; "
                "fly lower, bank less or use a coarser texture"
            )
        out = np.empty((y1 - y0, x1 - x0, *self.channels), np.uint8)
        for row in range(y0 // TILE, (y1 - 1) // TILE + 1):
            for column in range(x0 // TILE, (x1 - 1) // TILE + 1):
                _paste(out, self._tile(column, row), column * TILE - x0, row * TILE - y0)
        return out

    def _tile(self, column: int, row: int) -> Grey:
        key = column, row
        if key not in self._tiles:
            self._tiles[key] = self._make_tile(column, row)
            if len(self._tiles) > KEPT_TILES:
                self._tiles.popitem(last=False)
        self._tiles.move_to_end(key)
        return self._tiles[key]


class GrassTexture(Tiled):
    """Farmland: self-similar grass of many sizes, in fields of slightly different grey with hedges between."""

    def __init__(self, seed: int, *, m_per_px: float = TEXEL_M) -> None:
        super().__init__(m_per_px)
        self._seed = seed

    def _make_tile(self, column: int, row: int) -> Grey:
        shade, density, gap_m = self._fields(column, row)
        grass = noise_tile(GRASS_OCTAVES, column, row, self._seed)
        clump = octave(16, column, row, self._seed + 101)
        patch = octave(64, column, row, self._seed + 102)
        grey = 105.0 + shade + density * grass + 18.0 * clump * patch
        bush = np.clip(1.6 - gap_m / HEDGE_WIDTH_M + 1.2 * clump + 0.8 * patch, 0.0, 1.0)
        rut = _smooth_step(1.0 - np.abs(np.abs(self._off_track_m(column, row)) - 0.8) / 0.35 + 0.8 * clump)
        return to_grey(grey * (1.0 - 0.4 * bush) + 32.0 * rut)

    def _fields(self, column: int, row: int) -> tuple[Noise, Noise, Noise]:
        """Return shade offset, grass contrast and distance to the border [m], from the nearest jittered centre."""
        nodes = _nodes(FIELD_STEP) * FIELD_STEP
        x = (column * TILE + nodes) * self.m_per_px / FIELD_SIZE_M
        y = (row * TILE + nodes) * self.m_per_px / FIELD_SIZE_M
        grid_x, grid_y = np.meshgrid(x, y)
        shade, density, gap = _nearest_field(grid_x, grid_y, self._seed)
        return _enlarge(shade, FIELD_STEP), _enlarge(density, FIELD_STEP), _enlarge(gap * FIELD_SIZE_M, FIELD_STEP)

    def _off_track_m(self, column: int, row: int) -> Noise:
        """Return the signed distance of each texel from the nearest farm track [m]; tracks wind from west to east."""
        nodes = _nodes(FIELD_STEP) * FIELD_STEP
        x = (column * TILE + nodes) * self.m_per_px
        y = (row * TILE + nodes[:, None]) * self.m_per_px
        bend = (
            0.4
            * TRACK_SPACING_M
            * np.sin(2.0 * np.pi * x / 310.0 + self._seed)
            * np.sin(2.0 * np.pi * x / 1370.0 + 1.0)
        )
        off = y - bend
        return _enlarge(off - TRACK_SPACING_M * np.rint(off / TRACK_SPACING_M), FIELD_STEP)


class ImageTexture(Tiled):
    """Photographs of ground tiled side by side; they repeat, so fine noise makes the copies differ."""

    def __init__(self, paths: list[Path], seed: int, *, image_m_per_px: float) -> None:
        """Read the pictures.

        Args:
            paths: image files; they are cut to the size of the smallest one.
            seed: of the added noise.
            image_m_per_px: size of a picture's pixel on the ground [m].

        Raises:
            ConfigError: a file is not a readable image, or its pixels' size leaves nothing of it.
        """
        super().__init__()
        self._seed = seed
        pictures = [_read_grey(path, image_m_per_px / self.m_per_px) for path in paths]
        height, width = min(p.shape[0] for p in pictures), min(p.shape[1] for p in pictures)
        self._pictures = [np.flipud(p[:height, :width]) for p in pictures]

    def _make_tile(self, column: int, row: int) -> Grey:
        out = np.empty((TILE, TILE), np.uint8)
        height, width = self._pictures[0].shape
        x0, y0 = column * TILE + width // 2, row * TILE + height // 2  # the world origin is inside a picture
        for i in range(y0 // height, (y0 + TILE - 1) // height + 1):
            for j in range(x0 // width, (x0 + TILE - 1) // width + 1):
                _paste(out, self._pictures[(j + 2 * i) % len(self._pictures)], j * width - x0, i * height - y0)
        return to_grey(out + noise_tile(DETAIL_OCTAVES, column, row, self._seed))


def texture_from(source: str, seed: int, *, image_m_per_px: float) -> Texture:
    """Return the texture that a scenario names: "grass", an image file or a folder of image files.

    Raises:
        ConfigError: there is no such file, it holds no image, or its pixels have no size that can be drawn.
    """
    if source == "grass":
        return GrassTexture(seed)
    path = Path(source)
    files = sorted(p for p in path.iterdir() if p.suffix.lower() in IMAGE_SUFFIXES) if path.is_dir() else [path]
    if not files or not files[0].is_file():
        raise ConfigError(f"texture {source!r} is neither 'grass' nor an image nor a folder with images")
    return ImageTexture(files, seed, image_m_per_px=image_m_per_px)


def _paste(out: Grey, tile: Grey, x: int, y: int) -> None:
    """Copy `tile` into `out` with its corner at column x, row y; parts outside are clipped."""
    left, top = max(x, 0), max(y, 0)
    right, bottom = min(x + tile.shape[1], out.shape[1]), min(y + tile.shape[0], out.shape[0])
    if left < right and top < bottom:
        out[top:bottom, left:right] = tile[top - y : bottom - y, left - x : right - x]


def to_grey(values: NDArray[np.floating]) -> Grey:
    """Return grey levels rounded to 8 bits."""
    return np.clip(np.rint(values), 0, 255).astype(np.uint8)


def noise_tile(octaves: tuple[tuple[int, float], ...], column: int, row: int, seed: int) -> Noise:
    """Return one (TILE, TILE) tile of noise: the sum of octaves, each a spacing and an amplitude."""
    total = np.zeros((TILE, TILE), np.float32)
    for k, (spacing, amplitude) in enumerate(octaves):
        total += np.float32(amplitude) * octave(spacing, column, row, seed + k)
    return total


def octave(spacing: int, column: int, row: int, seed: int) -> Noise:
    """Return one tile of smooth noise in about [-1, 1] whose lattice has a node every `spacing` texels."""
    nodes = _nodes(spacing)
    lattice = hashed(nodes + column * (TILE // spacing), (nodes + row * (TILE // spacing))[:, None], seed)
    return _enlarge(2.0 * lattice - 1.0, spacing)


def _nodes(spacing: int) -> NDArray[np.int64]:
    """Return the indices of the lattice nodes, `spacing` texels apart, that a tile depends on."""
    return np.arange(-1, TILE // spacing + 2)


def _enlarge(values: NDArray[np.floating], spacing: int) -> Noise:
    """Interpolate values at `_nodes` x `_nodes` to every texel of a tile."""
    W = _interpolation(spacing)
    return np.asarray(W @ values.astype(np.float32) @ W.T)


@functools.cache
def _interpolation(spacing: int) -> Noise:
    """Return the (TILE, nodes) weights of cubic (Catmull-Rom) interpolation between nodes."""
    cell, texel = np.divmod(np.arange(TILE), spacing)
    f = texel / spacing
    weights = 0.5 * np.stack([-(f**3) + 2 * f**2 - f, 3 * f**3 - 5 * f**2 + 2, -3 * f**3 + 4 * f**2 + f, f**3 - f**2])
    W = np.zeros((TILE, len(_nodes(spacing))), np.float32)
    for k in range(4):
        W[np.arange(TILE), cell + k] = weights[k]
    return W


def _smooth_step(values: NDArray[np.floating]) -> NDArray[np.floating]:
    x = np.clip(values, 0.0, 1.0)
    return np.asarray(x * x * (3.0 - 2.0 * x))


def _nearest_field(
    x: NDArray[np.float64], y: NDArray[np.float64], seed: int
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return shade, contrast and distance to the border (in field sizes) of the field at each x, y (in field sizes)."""
    first, second = np.full(x.shape, np.inf), np.full(x.shape, np.inf)
    shade, density = np.zeros(x.shape), np.ones(x.shape)
    for i in range(int(np.floor(y.min())) - 1, int(np.floor(y.max())) + 2):
        for j in range(int(np.floor(x.min())) - 1, int(np.floor(x.max())) + 2):
            dx, dy, grey, contrast = (float(hashed(np.array(j), np.array(i), seed + 200 + k)) for k in range(4))
            distance = np.hypot(x - j - 0.15 - 0.7 * dx, y - i - 0.15 - 0.7 * dy)
            nearer = distance < first
            second = np.where(nearer, first, np.minimum(second, distance))
            first = np.where(nearer, distance, first)
            shade = np.where(nearer, 50.0 * (grey - 0.5), shade)
            density = np.where(nearer, 0.8 + 0.5 * contrast, density)
    return shade, density, 0.5 * (second - first)


def hashed(x: NDArray[np.integer], y: NDArray[np.integer], seed: int) -> NDArray[np.float64]:
    """Return uniform numbers in [0, 1) that depend only on the integers x, y (broadcast) and seed."""
    with np.errstate(over="ignore"):  # overflow is the mixing step
        h = x.astype(np.uint32) * np.uint32(0x8DA6B343) ^ y.astype(np.uint32) * np.uint32(0xD8163841)
        h = h ^ np.uint32((seed * 0x9E3779B1) & 0xFFFFFFFF)
        h = (h ^ (h >> np.uint32(16))) * np.uint32(0x7FEB352D)
        h = (h ^ (h >> np.uint32(15))) * np.uint32(0x846CA68B)
        h = h ^ (h >> np.uint32(16))
    return np.asarray(h / 4294967296.0)


def _read_grey(path: Path, scale: float) -> Grey:
    image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    if image is None:
        raise ConfigError(f"texture {path} is not a readable image")
    method = cv2.INTER_AREA if scale < 1.0 else cv2.INTER_CUBIC
    try:
        return np.asarray(cv2.resize(image, None, fx=scale, fy=scale, interpolation=method))
    except cv2.error:
        height, width = image.shape
        raise ConfigError(
            f"texture {path} of {width} x {height} pixels of {scale * TEXEL_M:g} m can't be drawn with texels of "
            f"{TEXEL_M:g} m; give its pixels another size"
        ) from None
