# SPDX-License-Identifier: Apache-2.0
"""The mosaic's tiles.

Fine bands hold the coefficients of the view that sees a spot best, coarse bands the mean over all views, weighted by
how well each one sees the spot; so detail is never averaged, and brightness has no step. [bu16] chooses one view in
the coarse bands too.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from uav_vslam.errors import UavVslamError
from uav_vslam.mapping.orthomosaic.pyramid import LEVELS, Bands, at_level
from uav_vslam.mapping.tile_store import SIDE, TileStore

Real = NDArray[np.float32]
Labels = NDArray[np.int32]

BEST_LEVELS = 3  # finest bands that come from one view
MEAN_POWER = 2  # of the weight in the mean of the coarse bands
STEPS = 16  # to a grey level in the int16 of the finest bands; float16 takes ten times as long to convert
UNSEEN = -1


@dataclass(frozen=True, slots=True)
class Tile:
    """What is known of one tile.

    Attributes:
        labels: (SIDE, SIDE) int32 number of the view that sees a pixel best; UNSEEN without any.
        bands: of each level (SIDE >> l, SIDE >> l, channels): int16 coefficients in STEPS, of the coarse levels float32
            ones times their weight.
        weights: of each level (SIDE >> l, SIDE >> l): of the best view, of the coarse ones their sum.
    """

    labels: Labels
    bands: list[NDArray[Any]]
    weights: list[Real]

    @staticmethod
    def empty(channels: int) -> "Tile":
        """Return a tile that nothing was seen of."""
        kinds = [np.int16 if level < BEST_LEVELS else np.float32 for level in range(LEVELS + 1)]
        sides = [SIDE >> level for level in range(LEVELS + 1)]
        return Tile(
            np.full((SIDE, SIDE), UNSEEN, np.int32),
            [np.zeros((side, side, channels), kind) for side, kind in zip(sides, kinds, strict=True)],
            [np.zeros((side, side), np.float32) for side in sides],
        )

    @property
    def arrays(self) -> tuple[NDArray[Any], ...]:
        """All that it holds."""
        return self.labels, *self.bands, *self.weights

    @property
    def nbytes(self) -> int:
        """Size in memory, and of its file."""
        return sum(array.nbytes for array in self.arrays)

    def merge(self, view: int, bands: Bands, score: Real, at: tuple[slice, slice], cut: tuple[slice, slice]) -> None:
        """Add a view in place.

        Args:
            view: its number.
            bands: of its window.
            score: (rows, columns) of its window; 0 where it sees nothing.
            at, cut: slices of the common pixels in the tile and in the window; multiples of 2^LEVELS.
        """
        seen = score[cut] > 0
        for level in range(LEVELS + 1):
            here, there = at_level(at, level), at_level(cut, level)
            weight, coefficients = bands.weights[level][there], bands.coefficients[level][there]
            own_weight, own = self.weights[level][here], self.bands[level][here]
            if level < BEST_LEVELS:
                better = (weight > own_weight).view(np.uint8)  # OpenCV's masks are bytes, and fast
                if not better.any():
                    continue
                if level == 0:
                    cv2.copyTo(np.full(better.shape, view, np.int32), better * seen, self.labels[here])
                np.maximum(own_weight, weight, out=own_weight)
                cv2.copyTo(cv2.multiply(coefficients, (STEPS,) * 4, dtype=cv2.CV_16S), better, own)
            else:
                weight = weight**MEAN_POWER
                own_weight += weight
                own += weight[..., None] * coefficients

    def coefficients(self, level: int) -> Real:
        """Return the band of a level (SIDE >> level, SIDE >> level, channels) as it adds to the picture."""
        band = self.bands[level]
        if level < BEST_LEVELS:
            return band.astype(np.float32) / np.float32(STEPS)
        return np.asarray(band / np.maximum(self.weights[level], np.float32(1e-30))[..., None])


class MosaicTiles(TileStore[Tile]):
    """Tiles of a picture; a file holds a tile's arrays one after the other."""

    SUFFIX = ".bin"

    def __init__(self, m_per_px: float, channels: int, folder: Path | None, *, kept_bytes: int) -> None:
        """Prepare an empty store.

        Args:
            m_per_px: side of a pixel [m].
            channels: of the picture.
            folder: for tiles that are not used; None keeps all in memory.
            kept_bytes: largest size of the tiles in memory.
        """
        super().__init__(m_per_px, folder, most_tiles=max(4, kept_bytes // Tile.empty(channels).nbytes))
        self.channels = channels

    def _empty(self) -> Tile:
        return Tile.empty(self.channels)

    def _write(self, tile: Tile, path: Path) -> None:
        with path.open("wb") as file:  # a third of the time of numpy.savez, which matters with large views
            for array in tile.arrays:
                array.tofile(file)

    def _read(self, path: Path) -> Tile:
        tile = self._empty()
        try:
            with path.open("rb") as file:
                read = sum(file.readinto(array.data) for array in tile.arrays)
        except OSError as error:
            raise UavVslamError(f"tile {path} of the mosaic can't be read ({error}); make the map again") from error
        if read != tile.nbytes:
            raise UavVslamError(f"tile {path} of the mosaic has {read} of {tile.nbytes} bytes; make the map again")
        return tile
