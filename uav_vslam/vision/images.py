# SPDX-License-Identifier: Apache-2.0
"""Conversion of camera images for the extractors: 8 bits, grey or colour, downscaled."""

from typing import TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from uav_vslam.errors import InvalidMessage

Pixel = TypeVar("Pixel", bound=np.generic)

STRETCH_PERCENTILES = (0.5, 99.5)  # of a 16-bit image, mapped to 0 and 255: robust to hot pixels and glints
STRETCH_STEP = 4  # the percentiles are taken from every fourth row and column


def to_grey8(image: NDArray[np.generic]) -> NDArray[np.uint8]:
    """Return an image as (H, W) uint8.

    Args:
        image: (H, W) or (H, W, 1) grey or (H, W, 3) BGR, uint8 or uint16.

    Raises:
        InvalidMessage: another shape or type.
    """
    image = _checked(image)
    return _to_8_bits(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) if image.ndim == 3 else image)


def to_bgr8(image: NDArray[np.generic]) -> NDArray[np.uint8]:
    """Return an image as (H, W, 3) uint8, a grey one with equal channels; arguments and errors are `to_grey8`'s."""
    image = _checked(image)
    return _to_8_bits(cv2.cvtColor(image, cv2.COLOR_GRAY2BGR) if image.ndim == 2 else image)


def _checked(image: NDArray[np.generic]) -> NDArray[np.generic]:
    """Return a valid image, a grey one as (H, W)."""
    if image.dtype not in (np.uint8, np.uint16):
        raise InvalidMessage("image_type", f"images of {image.dtype} can't be used; send mono8, bgr8 or mono16")
    if image.ndim == 3 and image.shape[2] == 1:
        image = image[:, :, 0]
    if not (image.ndim == 2 or (image.ndim == 3 and image.shape[2] == 3)) or image.size == 0:
        raise InvalidMessage("image_shape", f"an image of shape {image.shape} can't be used; send (H, W) or (H, W, 3)")
    return image


def _to_8_bits(image: NDArray[np.generic]) -> NDArray[np.uint8]:
    return _stretch(image) if image.dtype == np.uint16 else np.ascontiguousarray(image, np.uint8)


def _stretch(image: NDArray[np.generic]) -> NDArray[np.uint8]:
    """Map a 16-bit image's own range to 8 bits: sensors fill 10, 12 or 16 bits, and which is unknown."""
    low, high = np.percentile(image[::STRETCH_STEP, ::STRETCH_STEP].astype(np.float32), STRETCH_PERCENTILES)
    if high - low < 1.0:
        return np.zeros(image.shape, np.uint8)
    return stretched(image, low, high)


def stretched(image: NDArray[np.generic], black: float, white: float) -> NDArray[np.uint8]:
    """Return an image whose black and white levels have become 0 and 255."""
    levels = (image.astype(np.float32) - np.float32(black)) * np.float32(255.0 / (white - black))
    return np.asarray(np.clip(np.rint(levels), 0, 255), np.uint8)


def shrink(image: NDArray[Pixel], scale: float) -> NDArray[Pixel]:
    """Downscale an image by `scale` with an area average, which neither aliases nor shifts.

    Raises:
        InvalidMessage: a shape or type that `to_grey8` rejects.
    """
    if scale == 1.0:
        return image
    height, width = image.shape[:2]
    size = (max(1, round(width * scale)), max(1, round(height * scale)))
    small: NDArray[Pixel] = cv2.resize(_checked(image), size, interpolation=cv2.INTER_AREA)
    return small


def quarter(image: NDArray[Pixel]) -> NDArray[Pixel]:
    """Downscale an image to a quarter by halving it twice, seven times as fast as `shrink`."""
    for _ in range(2):
        image = shrink(image, 0.5)
    return image


def to_full_resolution(
    pixels: NDArray[np.floating], shrunk: tuple[int, ...], full: tuple[int, ...]
) -> NDArray[np.float64]:
    """Map pixels to the full-resolution image: p_full = (p + 0.5) / scale - 0.5, as pixel centres are integers.

    Args:
        pixels: (N, 2) u, v in the downscaled image [px].
        shrunk, full: (height, width) of both images [px]; their ratio is the scale after rounding.
    """
    scale = np.array([shrunk[1] / full[1], shrunk[0] / full[0]])
    return np.asarray((np.asarray(pixels, float) + 0.5) / scale - 0.5)


def to_shrunk(pixels: NDArray[np.floating], shrunk: tuple[int, ...], full: tuple[int, ...]) -> NDArray[np.float64]:
    """Map pixels to the downscaled image, the inverse of `to_full_resolution`."""
    scale = np.array([shrunk[1] / full[1], shrunk[0] / full[0]])
    return np.asarray((np.asarray(pixels, float) + 0.5) * scale - 0.5)
