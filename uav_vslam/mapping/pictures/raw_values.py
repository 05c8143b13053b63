# SPDX-License-Identifier: Apache-2.0
"""Which values of a camera's 16-bit images are black and white: sensors fill 10, 12 or 16 bits, and which is unknown.

The same levels for all images keep their brightness comparable. Exposures differ by a factor, which an offset would
spoil, so black is zero unless that left less than half of the grey levels to the images, as with temperatures.
"""

from collections import defaultdict
from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from uav_vslam.mapping.opacity import Mask
from uav_vslam.mapping.pictures.picture import Picture
from uav_vslam.vision.images import STRETCH_PERCENTILES

SAMPLES = 100  # along each side of an image, about
OFFSET_SHARE = 0.5  # of the brightest values that the darkest must reach to be black instead of zero


class RawValues:
    """Samples of 16-bit images by camera."""

    def __init__(self) -> None:
        """Start without any."""
        self._samples: defaultdict[str, list[NDArray[np.generic]]] = defaultdict(list)

    def add(self, camera: str, image: NDArray[np.generic], opaque: Mask | None = None) -> None:
        """Take an image, grey or BGR, into account where it is opaque; one of 8 bits has its levels already."""
        if image.dtype == np.uint16:
            step = max(1, min(image.shape[:2]) // SAMPLES)
            sampled = image[::step, ::step]
            self._samples[camera].append((sampled if opaque is None else sampled[opaque[::step, ::step]]).ravel())

    def levelled(self, pictures: Iterable[Picture]) -> list[Picture]:
        """Return pictures with the levels of their cameras."""
        return [replace(picture, levels=self.levels(picture.camera)) for picture in pictures]

    def levels(self, camera: str) -> tuple[float, float] | None:
        """Return the values that become black and white; None if there is no image, or all of it is one value."""
        if not (samples := self._samples.get(camera)):
            return None
        values = np.concatenate(samples)
        if not len(values):
            return None
        low, high = np.percentile(values, STRETCH_PERCENTILES)
        black = float(low) if low >= OFFSET_SHARE * high else 0.0
        return (black, float(high)) if high - black >= 1.0 else None
