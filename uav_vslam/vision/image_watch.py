# SPDX-License-Identifier: Apache-2.0
"""Is a camera alive? What one camera's images say about it, one after the other."""

from collections import deque

import cv2
import numpy as np
from numpy.typing import NDArray

Grey = NDArray[np.uint8]

STEP_PX = 8  # frozen and dark images are told by every eighth row and column
LEAST_CONTRAST = 6.0  # grey levels between the 2nd and 98th percentile; less is night, a cap, a white-out
EXPOSURE_JUMP = 1.4  # of the mean brightness from one image to the next
BLURRED = 0.5  # of the usual sharpness
SHARPNESS_SCALE = 0.25  # of the image: noise is averaged away, motion blur of a few pixels is not
USUAL_FRAMES = 300  # half a minute; smoother ground becomes usual in that time, and a blur that lasts as well
USUAL_QUANTILE = 0.75  # of their sharpness is the usual one: most of them must be blurred before blur is
MIN_USUAL_FRAMES = 5


class ImageWatch:
    """Watches one camera.

    Attributes:
        blind: the last image shows nothing new: it must not be used.
    """

    def __init__(self) -> None:
        self._before: Grey | None = None
        self._sharpness: deque[float] = deque(maxlen=USUAL_FRAMES)
        self.blind = False

    def add(self, image: Grey) -> list[str]:
        """Take note of an (H, W) image and return what is wrong with it; nothing as a rule."""
        sample = image[::STEP_PX, ::STEP_PX].copy()
        before, self._before = self._before, sample
        was_blind = self.blind
        low, high = np.percentile(sample, (2.0, 98.0))
        if high - low < LEAST_CONTRAST:
            self.blind = True
            return [f"shows nothing (contrast {high - low:.0f} of 255)"]
        if before is not None and np.array_equal(before, sample):
            self.blind = True
            return ["is frozen: it repeats its last image"]
        self.blind = False
        return [*([] if was_blind else _exposure(before, sample)), *self._blur(image)]

    def _blur(self, image: Grey) -> list[str]:
        """Compare the sharpness with the usual one."""
        small = cv2.resize(image, None, fx=SHARPNESS_SCALE, fy=SHARPNESS_SCALE, interpolation=cv2.INTER_AREA)
        sharpness = float(cv2.Laplacian(small, cv2.CV_32F).std() / max(float(small.std()), 1.0))
        enough = len(self._sharpness) >= MIN_USUAL_FRAMES
        usual = float(np.quantile(self._sharpness, USUAL_QUANTILE)) if enough else 0.0
        self._sharpness.append(sharpness)
        blurred = sharpness < BLURRED * usual
        return [f"is blurred: {100.0 * sharpness / usual:.0f} % of its usual sharpness"] if blurred else []


def _exposure(before: Grey | None, sample: Grey) -> list[str]:
    if before is None:
        return []
    ratio = (float(sample.mean()) + 1.0) / (float(before.mean()) + 1.0)
    return [f"jumped in brightness by a factor of {ratio:.2g}"] if max(ratio, 1.0 / ratio) > EXPOSURE_JUMP else []
