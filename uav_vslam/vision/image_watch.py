# SPDX-License-Identifier: Apache-2.0
"""Fault detection for one camera from its images: frozen, blind, exposure jumps, blur."""

import statistics
from collections import deque

import cv2
import numpy as np
from numpy.typing import NDArray

from uav_vslam.vision.images import quarter

Grey = NDArray[np.uint8]

STEP_PX = 8  # subsampling for frozen and dark images
MIN_CONTRAST = 6.0  # see `contrast`; less is night, a lens cap, a white-out
CONTRAST_SHARES = (0.02, 0.98)  # of the pixels
EXPOSURE_JUMP = 1.4  # of the mean brightness from one image to the next
BLURRED = 0.7  # of the usual sharpness; a Gaussian blur of 2.2 px leaves 0.56 to 0.7, other ground and rooms 0.85
MOTION_BLURRED = 0.7  # of the usual isotropy of fine detail; 5 px of motion blur leave 0.55
ISOTROPY_SCALE = 0.5  # of the image's middle: motion blur of a few pixels is not averaged away
SPREADS = 2.0  # below the median, in interquartile ranges: within it the variation is normal
USUAL_FRAMES = 300  # half a minute of baseline; a change that lasts so long becomes the new baseline
MIN_USUAL_FRAMES = 5


class ImageWatch:
    """Monitors one camera.

    Attributes:
        blind: the last image is frozen or without contrast: it must not be used.
    """

    def __init__(self) -> None:
        self._before: Grey | None = None
        self._sharpness, self._isotropy = RunningBaseline(BLURRED), RunningBaseline(MOTION_BLURRED)
        self.blind = False

    def add(self, image: Grey) -> list[str]:
        """Check an (H, W) image and return its faults; normally none."""
        sample = image[::STEP_PX, ::STEP_PX].copy()
        before, self._before = self._before, sample
        was_blind = self.blind
        spread = contrast(sample)
        if spread < MIN_CONTRAST:
            self.blind = True
            return [f"shows nothing (contrast {spread:.0f} of 255)"]
        if before is not None and np.array_equal(before, sample):
            self.blind = True
            return ["is frozen: it repeats its last image"]
        self.blind = False
        return [*([] if was_blind else _exposure(before, sample)), *self._blur(image)]

    def _blur(self, image: Grey) -> list[str]:
        """Compare sharpness and isotropy of fine detail with their baselines."""
        sharpness = self._sharpness.shortfall(_sharpness(image))
        isotropy = self._isotropy.shortfall(_isotropy(image))
        if isotropy is not None:
            return [f"is blurred by motion: detail along it is down to {100.0 * isotropy:.0f} % of the usual"]
        return [] if sharpness is None else [f"is blurred: {100.0 * sharpness:.0f} % of its usual sharpness"]


def contrast(image: Grey) -> float:
    """Return the grey levels between the 2nd and the 98th percentile of an (H, W) image."""
    shares = np.cumsum(cv2.calcHist([image], [0], None, [256], [0, 256])) / image.size
    low, high = np.searchsorted(shares, CONTRAST_SHARES)
    return float(high - low)


class RunningBaseline:
    """Running baseline of an image statistic."""

    def __init__(self, least_share: float) -> None:
        """Start; values below that share of the median are unusual."""
        self._least_share = least_share
        self._values: deque[float] = deque(maxlen=USUAL_FRAMES)
        self._unusual_frames = 0

    def shortfall(self, value: float) -> float | None:
        """Return an unusually small value's share of the median; otherwise add it to the baseline and return None."""
        if len(self._values) >= MIN_USUAL_FRAMES:
            low, usual, high = statistics.quantiles(self._values, n=4, method="inclusive")
            if value < usual - max((1.0 - self._least_share) * usual, SPREADS * (high - low)):
                self._unusual_frames += 1
                if self._unusual_frames < USUAL_FRAMES:
                    return float(value / usual)
                self._values.clear()
        self._unusual_frames = 0
        self._values.append(float(value))
        return None


def _sharpness(image: Grey) -> float:
    """Return the fine detail of an (H, W) image over that twice as coarse, which a dark hedge hardly changes."""
    fine = quarter(image)  # averages noise away
    coarse = cv2.resize(fine, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
    details = (_deviation(cv2.Laplacian(one, cv2.CV_16S)) for one in (fine, coarse))
    return next(details) / max(next(details), 1.0)


def _deviation(image: NDArray[np.generic]) -> float:
    _, deviation = cv2.meanStdDev(image)
    return float(deviation[0, 0])


def _isotropy(image: Grey) -> float:
    """Return the isotropy of fine detail: near 1 for any ground texture, less under motion blur.

    Ratio of the smaller to the larger second derivative, along 0 and 90 degrees and along 45 and 135.
    """
    height, width = image.shape
    middle = image[height // 4 : height - height // 4, width // 4 : width - width // 4]
    small = cv2.resize(middle, None, fx=ISOTROPY_SCALE, fy=ISOTROPY_SCALE, interpolation=cv2.INTER_AREA)
    xx, yy, xy = (cv2.Sobel(small, cv2.CV_16S, *orders) for orders in ((2, 0), (0, 2), (1, 1)))
    total, twice = cv2.add(xx, yy), cv2.add(xy, xy)  # twice the derivative along 45 degrees is their sum
    diagonals = cv2.add(total, twice), cv2.subtract(total, twice)
    pairs = [(cv2.norm(one), cv2.norm(other)) for one, other in ((xx, yy), diagonals)]
    return min(min(pair) / max(max(pair), 1e-9) for pair in pairs)


def _exposure(before: Grey | None, sample: Grey) -> list[str]:
    if before is None:
        return []
    ratio = (float(sample.mean()) + 1.0) / (float(before.mean()) + 1.0)
    return [f"jumped in brightness by a factor of {ratio:.2g}"] if max(ratio, 1.0 / ratio) > EXPOSURE_JUMP else []
