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
SPREADS = 2.0  # below the median, in widths of the middle half: what varies so much by itself is nothing unusual
USUAL_FRAMES = 300  # half a minute, in which what is usual is learnt; what is unusual for so long becomes usual
MIN_USUAL_FRAMES = 5


class ImageWatch:
    """Watches one camera.

    Attributes:
        blind: the last image shows nothing new: it must not be used.
    """

    def __init__(self) -> None:
        self._before: Grey | None = None
        self._sharpness, self._likeness = RunningBaseline(BLURRED), RunningBaseline(SMEARED)
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
        sharpness = self._sharpness.shortfall(cv2.Laplacian(small, cv2.CV_32F).std() / max(float(small.std()), 1.0))
        likeness = self._likeness.shortfall(_likeness(image))
        if likeness is not None:
            return [f"is blurred by motion: detail along it is down to {100.0 * likeness:.0f} % of the usual"]
        return [] if sharpness is None else [f"is blurred: {100.0 * sharpness:.0f} % of its usual sharpness"]


class RunningBaseline:
    """What a figure of the images is as a rule."""

    def __init__(self, least_share: float) -> None:
        """Begin; what is below that share of the median is unusual."""
        self._least_share = least_share
        self._values: deque[float] = deque(maxlen=USUAL_FRAMES)
        self._unusual_frames = 0

    def shortfall(self, value: float) -> float | None:
        """Return the share of the usual that an unusually small value is; learn from any other."""
        if len(self._values) >= MIN_USUAL_FRAMES:
            low, usual, high = np.quantile(self._values, (0.25, 0.5, 0.75))
            if value < usual - max((1.0 - self._least_share) * usual, SPREADS * (high - low)):
                self._unusual_frames += 1
                if self._unusual_frames < USUAL_FRAMES:
                    return float(value / usual)
                self._values.clear()
        self._unusual_frames = 0
        self._values.append(float(value))
        return None


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
