# SPDX-License-Identifier: Apache-2.0
"""Interface of the feature extractors."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

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

    def chosen(self, rows: NDArray[np.intp]) -> "Keypoints":
        """Return some of the keypoints, by rows."""
        return Keypoints(self.pixels[rows], self.responses[rows], self.descriptors[rows])


Choice = Callable[[NDArray[np.float32]], NDArray[np.intp]]  # (N, 2) pixels, strongest first, to the rows wanted


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


@runtime_checkable
class SelectiveExtractor(Extractor, Protocol):
    """An extractor that describes the points wanted alone, which saves most of its time."""

    def detect_chosen(self, image: NDArray[np.generic], choose: Choice) -> Keypoints:
        """Return the chosen ones of the keypoints that `detect` returns, the same to the last bit."""
        ...


def detect_chosen(extractor: Extractor, image: NDArray[np.generic], choose: Choice) -> Keypoints:
    """Return the chosen keypoints of an image; an extractor that can't select describes all of them."""
    if isinstance(extractor, SelectiveExtractor):
        return extractor.detect_chosen(image, choose)
    found = extractor.detect(image)
    return found.chosen(choose(found.pixels))


def no_keypoints(length: int) -> Keypoints:
    """Return no keypoints, with descriptors of `length` numbers."""
    return Keypoints(np.zeros((0, 2), np.float32), np.zeros(0, np.float32), np.zeros((0, length), np.uint8))


def strongest_first(keypoints: Keypoints, count: int) -> Keypoints:
    """Return the `count` strongest keypoints."""
    return keypoints.chosen(by_strength(keypoints.pixels, keypoints.responses)[:count])


def by_strength(pixels: NDArray[np.float32], responses: NDArray[np.float32]) -> NDArray[np.intp]:
    """Return the rows of (N, 2) points, strongest first; ties by position, so the order depends on the image only."""
    return np.lexsort((pixels[:, 0], pixels[:, 1], -responses))
