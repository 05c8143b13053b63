# SPDX-License-Identifier: Apache-2.0
"""Bands of a rectified view, on grids that are the same for all views and tiles.

Level l has pixels of 2^l. A window whose edges are multiples of 2^LEVELS has the same centres at every level as any
other, so bands of different views can stand side by side and still add up to a picture without a step [burt83].
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

Real = NDArray[np.float32]

LEVELS = 5  # beside the finest
ALIGN = 2**LEVELS
MARGIN = 2 * ALIGN  # around what is seen: as far as the coarsest band reaches
REACH = 3 * ALIGN  # around a pixel, of those that its bands depend on
FILLED_WEIGHT = 1e-4  # of a band where the view sees nothing: enough to continue what it saw


@dataclass(frozen=True, slots=True)
class Bands:
    """A view, taken apart.

    Attributes:
        coefficients: LEVELS + 1 arrays (rows >> l, columns >> l, channels) float32; the last one is the coarse rest.
        weights: (rows >> l, columns >> l) float32 each, positive everywhere.
    """

    coefficients: list[Real]
    weights: list[Real]


def take_apart(image: Real, score: Real) -> Bands:
    """Return the bands of an image.

    Args:
        image: (rows, columns, channels) float32; both sides are multiples of ALIGN.
        score: (rows, columns) float32; 0 where the image is not known.
    """
    continued = fill(score[..., None], score > 0)[..., 0]
    filled = fill(image, score > 0)
    coefficients, weights = [], []
    seen = (score > 0).astype(np.float32)
    for level in range(LEVELS + 1):
        mixed = np.square(np.square(seen))  # falls fast with the share of a pixel that is not seen
        weights.append(np.maximum(score * mixed, np.float32(FILLED_WEIGHT) * continued))
        if level == LEVELS:
            coefficients.append(filled)
            break
        smaller = _down(filled)
        enlarged = _up(smaller)
        coefficients.append(np.subtract(filled, enlarged, out=enlarged))  # views are large: no more copies than needed
        filled = smaller
        score, seen, continued = (cv2.pyrDown(a) for a in (score, seen, continued))
    return Bands(coefficients, weights)


def put_together(coefficients: list[Real]) -> Real:
    """Return the (rows, columns, channels) picture of its bands, finest first."""
    picture = coefficients[-1]
    for finer in coefficients[-2::-1]:
        picture = _up(picture) + finer
    return picture


def at_level(at: tuple[slice, slice], level: int) -> tuple[slice, slice]:
    """Return the slices of a level for those of the finest one, whose ends are multiples of ALIGN."""
    rows, columns = at
    return slice(rows.start >> level, rows.stop >> level), slice(columns.start >> level, columns.stop >> level)


def fill(image: Real, known: NDArray[np.bool_]) -> Real:
    """Continue an (H, W, C) image smoothly where it is not known (H, W), from means over ever larger surroundings."""
    if known.all():
        return image
    seen = cv2.copyTo(image, known.view(np.uint8)).reshape(image.shape)
    return _filled(seen, known.astype(np.float32))


def _filled(weighted: Real, weight: Real) -> Real:
    if min(weight.shape) <= 2 or float(weight.min()) > 0.5:
        mean = weighted.sum(axis=(0, 1)) / np.maximum(weight.sum(), np.float32(1e-12))
        known = np.minimum(weight, 1.0)[..., None]
        return np.asarray(weighted + (1.0 - known) * mean, dtype=np.float32)
    coarse_weight, coarse = cv2.pyrDown(weight), _down(weighted)
    known = (coarse_weight > 1e-3).astype(np.float32)
    _scale(coarse, known / np.maximum(coarse_weight, np.float32(1e-3)))
    behind = _filled(coarse, known)
    size = weight.shape[1], weight.shape[0]
    enlarged = np.asarray(cv2.pyrUp(behind, dstsize=size), np.float32).reshape(weighted.shape)
    _scale(enlarged, 1.0 - weight)
    enlarged += weighted
    return enlarged


def _scale(image: Real, factor: Real) -> None:
    """Multiply (H, W, C) by (H, W) in place; numpy takes twice as long over so short a last axis."""
    cv2.multiply(image, cv2.merge([factor] * image.shape[-1]), dst=image)


def _down(image: Real) -> Real:
    smaller = cv2.pyrDown(image)
    return np.asarray(smaller.reshape(*smaller.shape[:2], -1))


def _up(image: Real) -> Real:
    rows, columns = image.shape[:2]
    return np.asarray(cv2.pyrUp(image, dstsize=(2 * columns, 2 * rows)).reshape(2 * rows, 2 * columns, -1))
