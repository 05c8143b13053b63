# SPDX-License-Identifier: Apache-2.0
"""Feature tracks and their last observations."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Tracks:
    """Feature tracks; descriptors are from the start of the track.

    Attributes:
        ids: (N,) uint32 from 1, never reused.
        pixels: (N, 2) last observation in the left image, raw [px].
        depth_m: (N,) depth in the left camera [m]; NaN before the first match in the right image.
        descriptors: (N, D) uint8.
    """

    ids: NDArray[np.uint32]
    pixels: Array
    depth_m: Array
    descriptors: NDArray[np.uint8]

    @staticmethod
    def none() -> "Tracks":
        """Return no track."""
        return Tracks(np.zeros(0, np.uint32), np.zeros((0, 2)), np.zeros(0), np.zeros((0, 128), np.uint8))

    def __len__(self) -> int:
        return len(self.ids)

    def chosen(self, rows: NDArray[np.generic]) -> "Tracks":
        """Return some of the tracks, by rows or mask."""
        return Tracks(self.ids[rows], self.pixels[rows], self.depth_m[rows], self.descriptors[rows])

    def with_new(self, pixels: Array, descriptors: NDArray[np.uint8], first_id: int) -> "Tracks":
        """Append (M, 2) new points as tracks."""
        if len(self) == 0:
            descriptors_before = np.zeros((0, descriptors.shape[1]), np.uint8)
        else:
            descriptors_before = self.descriptors
        ids = np.arange(first_id, first_id + len(pixels), dtype=np.uint32)
        return Tracks(
            np.concatenate([self.ids, ids]),
            np.vstack([self.pixels, pixels]),
            np.concatenate([self.depth_m, np.full(len(pixels), np.nan)]),
            np.vstack([descriptors_before, descriptors]),
        )
