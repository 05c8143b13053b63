# SPDX-License-Identifier: Apache-2.0
"""Interface of the feature extractors."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class Keypoints:
    """Points of one image, strongest first.

    Attributes:
        pixels: (N, 2) float32 u, v [px] of the original image; (0, 0) is the centre of the first pixel.
        responses: (N,) float32 strength; comparable within one extractor only.
        descriptors: (N, D) uint8, compared by squared Euclidean distance for every extractor.
    """

    pixels: NDArray[np.float32]
    responses: NDArray[np.float32]
    descriptors: NDArray[np.uint8]

    def __len__(self) -> int:
        return len(self.pixels)


class Extractor(Protocol):
    """Detects and describes keypoints; deterministic, including their order."""

    def detect(self, image: NDArray[np.generic]) -> Keypoints:
        """Return the keypoints of an image; none without texture.

        Args:
            image: (H, W) grey or (H, W, 3) BGR, uint8 or uint16; extractors that need grey convert it.

        Raises:
            InvalidMessage: another shape or type, or no pixels.
        """
        ...


def no_keypoints(length: int) -> Keypoints:
    """Return no keypoints, with descriptors of `length` numbers."""
    return Keypoints(np.zeros((0, 2), np.float32), np.zeros(0, np.float32), np.zeros((0, length), np.uint8))


def strongest_first(keypoints: Keypoints, count: int) -> Keypoints:
    """Return the `count` strongest keypoints; ties are broken by position, so the order depends on the image only."""
    u, v = keypoints.pixels[:, 0], keypoints.pixels[:, 1]
    order = np.lexsort((u, v, -keypoints.responses))[:count]
    return Keypoints(keypoints.pixels[order], keypoints.responses[order], keypoints.descriptors[order])
