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
SMEARED = 0.7  # of the usual likeness of crossing directions; 5 px of motion blur leave 0.55
SHARPNESS_SCALE = 0.25  # of the image: noise is averaged away
LIKENESS_SCALE = 0.5  # of the image's middle: motion blur of a few pixels is not averaged away
USUAL_FRAMES = 300  # half a minute; smoother ground becomes usual in that time, and a blur that lasts as well
USUAL_QUANTILE = 0.75  # of theirs is usual: most of them must be blurred before blur is
MIN_USUAL_FRAMES = 5


class ImageWatch:
    """Watches one camera.

    Attributes:
        blind: the last image shows nothing new: it must not be used.
    """

    def __init__(self) -> None:
        self._before: Grey | None = None
        self._sharpness, self._likeness = Usual(), Usual()
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
        """Compare the sharpness with the usual one, and the fine detail across directions."""
        small = cv2.resize(image, None, fx=SHARPNESS_SCALE, fy=SHARPNESS_SCALE, interpolation=cv2.INTER_AREA)
        sharpness = self._sharpness.share(float(cv2.Laplacian(small, cv2.CV_32F).std() / max(float(small.std()), 1.0)))
        likeness = self._likeness.share(_likeness(image))
        if likeness < SMEARED:
            return [f"is blurred by motion: detail along it is down to {100.0 * likeness:.0f} % of the usual"]
        return [f"is blurred: {100.0 * sharpness:.0f} % of its usual sharpness"] if sharpness < BLURRED else []


class Usual:
    """What a figure of the images is as a rule."""

    def __init__(self) -> None:
        self._values: deque[float] = deque(maxlen=USUAL_FRAMES)

    def share(self, value: float) -> float:
        """Return a new value as a share of the usual one; 1 while too few are known."""
        usual = float(np.quantile(self._values, USUAL_QUANTILE)) if len(self._values) >= MIN_USUAL_FRAMES else value
        self._values.append(value)
        return value / usual if usual > 0.0 else 1.0


def _likeness(image: Grey) -> float:
    """Return how alike fine detail is along crossing directions, 1 for ground however smooth, less where it is smeared.

    Of the second derivatives along 0 and 90 degrees, and along 45 and 135, the smaller to the larger.
    """
    height, width = image.shape
    middle = image[height // 4 : height - height // 4, width // 4 : width - width // 4]
    small = cv2.resize(middle, None, fx=LIKENESS_SCALE, fy=LIKENESS_SCALE, interpolation=cv2.INTER_AREA)
    xx, yy, xy = (cv2.Sobel(small, cv2.CV_32F, *orders) for orders in ((2, 0), (0, 2), (1, 1)))
    mean = 0.5 * (xx + yy)
    pairs = [(cv2.norm(one), cv2.norm(other)) for one, other in ((xx, yy), (mean + xy, mean - xy))]
    return min(min(pair) / max(max(pair), 1e-9) for pair in pairs)


def _exposure(before: Grey | None, sample: Grey) -> list[str]:
    if before is None:
        return []
    ratio = (float(sample.mean()) + 1.0) / (float(before.mean()) + 1.0)
    return [f"jumped in brightness by a factor of {ratio:.2g}"] if max(ratio, 1.0 / ratio) > EXPOSURE_JUMP else []
