# SPDX-License-Identifier: Apache-2.0
"""Dense colour SIFT of several sizes: section 3.4.3.3 of [thesis], as VLFeat's `vl_phow` [bosch07, vedaldi10].

As there: bins of 4, 6, 8 and 10 px around the same points, smoothed to bin / 6, one descriptor of 128 numbers for each
of three colour channels, side by side; a grey image has three equal channels; the contrast is
that of the intensity (HSV: of the value; RGB: the mean of the three). The opponent channels are VLFeat's: the first is
the luminance, and a hundredth of it is added to the others so that grey areas are not empty.

Differences from VLFeat, besides those of `dense`: the Gaussian window is 2 bins, not 1.5; points below VLFeat's
contrast threshold are dropped, where VLFeat zeroes their descriptors; the opponent channels are stretched to 8 bits for
OpenCV's SIFT, to which the descriptor is invariant.
"""

from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import NDArray

from uav_vslam.config import FrontendConfig
from uav_vslam.vision.features.base import Keypoints, strongest_first
from uav_vslam.vision.features.dense import BINS, contrast_at, describe, grid
from uav_vslam.vision.images import to_bgr8

Channels = tuple[list[NDArray[np.uint8]], list[NDArray[np.uint8]]]

SIZES_PX = (4.0, 6.0, 8.0, 10.0)
MAGNIFICATION = 6.0
CONTRAST_THRESHOLD = 0.005 * 255.0  # mean gradient [grey levels per px]; VLFeat's images go from 0 to 1
MONOCHROME_SHARE = 0.01  # of the luminance in the opponent channels


class PhowExtractor:
    """Dense SIFT of four sizes in three colour channels: 384 numbers a descriptor, four sizes a grid point."""

    def __init__(self, config: FrontendConfig, colour: str) -> None:
        """Prepare for at most `max_features` points and sizes in a colour space: a name in COLOURS."""
        self._max_features = config.max_features
        self._channels = COLOURS[colour]

    def detect(self, image: NDArray[np.generic]) -> Keypoints:
        """Return at most `max_features` points of an image, those with the greatest contrast first."""
        channels, intensities = self._channels(to_bgr8(image))
        margin, count = 0.5 * BINS * max(SIZES_PX), max(1, self._max_features // len(SIZES_PX))
        places = grid(channels[0].shape, margin_px=margin, count=count)
        sizes = [_at_size(channels, intensities, places, size) for size in SIZES_PX]
        together = Keypoints(
            np.concatenate([found.pixels for found in sizes]),
            np.concatenate([found.responses for found in sizes]),
            np.concatenate([found.descriptors for found in sizes]),
        )
        return strongest_first(together, self._max_features)


def _at_size(
    channels: list[NDArray[np.uint8]],
    intensities: list[NDArray[np.uint8]],
    places: NDArray[np.float32],
    size_px: float,
) -> Keypoints:
    """Return the points of one size; the contrast is the mean over the `intensities`."""
    every = [contrast_at(channel, places, size_px, MAGNIFICATION) for channel in intensities]
    contrast = np.asarray(np.mean(every, axis=0), np.float32)
    good = contrast >= CONTRAST_THRESHOLD
    descriptors = [describe(channel, places[good], size_px, MAGNIFICATION) for channel in channels]
    return Keypoints(places[good], contrast[good], np.hstack(descriptors))


def _rgb(bgr: NDArray[np.uint8]) -> Channels:
    channels = list(cv2.split(bgr))[::-1]
    return channels, channels


def _hsv(bgr: NDArray[np.uint8]) -> Channels:
    channels = list(cv2.split(cv2.cvtColor(bgr, cv2.COLOR_BGR2HSV_FULL)))
    return channels, channels[2:]


def _opponent(bgr: NDArray[np.uint8]) -> Channels:
    blue, green, red = (channel.astype(np.float32) for channel in cv2.split(bgr))
    luminance = 0.3 * red + 0.59 * green + 0.11 * blue
    first = (red - green) / 2.0**0.5 + MONOCHROME_SHARE * luminance
    second = (red + green - 2.0 * blue) / 6.0**0.5 + MONOCHROME_SHARE * luminance
    intensity = np.asarray(np.rint(luminance), np.uint8)
    return [intensity, _stretched(first), _stretched(second)], [intensity]


def _stretched(channel: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Stretch a channel to 0..255."""
    low, high = float(channel.min()), float(channel.max())
    return np.asarray(np.rint((channel - low) * (255.0 / max(high - low, 1e-3))), np.uint8)


COLOURS: dict[str, Callable[[NDArray[np.uint8]], Channels]] = {"rgb": _rgb, "hsv": _hsv, "opponent": _opponent}
