# SPDX-License-Identifier: Apache-2.0
"""How noisy a flight's tracks are, measured by stereo geometry alone: no motion or map, right or wrong, changes it.

With weak texture, noise or compression of the images, tracks scatter more than on the flights that the configured noise
was found on. Their gates are then too narrow: most tracks are refused, the rest are weighted too much, and a right
calibration looks wrong. Across its epipolar line a right pixel is off by this noise and by errors of the calibration,
which are smooth over the image and fitted.

As long as the rig is rigid, a point keeps its distance from the line. If those of all points change together from image
to image, the cameras vibrate against each other, or are not exposed at the same time: points are then off along the
disparity, too, where nothing shows it.
"""

import math
from collections import deque

import numpy as np
from numpy.typing import NDArray

from uav_vslam.estimation.tracks import OFFSET
from uav_vslam.geometry.stereo import StereoRig
from uav_vslam.numerics import robust_sigma
from uav_vslam.types import StereoFeatures

Array = NDArray[np.float64]

LEAST_POINTS = 30  # a frame
FRAMES = 20  # averaged
LEAST_STEPS = 3  # from image to image, before they tell of a vibration
NOISE_RATIO = 1.5  # measured over configured; below it, what is configured counts
OUTLIER = 5.0  # standard deviations of a point that is matched wrongly: one of them would bend the smooth fit
MEDIAN_OF_SQUARES = 0.455  # of normal numbers of unit variance
MEDIAN_ERROR = 1.2533  # standard deviation of the median of many of them, times the root of their number


class TrackNoise:
    """Measures the noise of a stream of frames, and how far the rig vibrates."""

    def __init__(self) -> None:
        self._variance_px2, self._frames = 0.0, 0
        self._tracks, self._pixels = np.zeros(0, np.uint32), np.zeros((0, 4))  # of the last frame
        self._steps: deque[tuple[float, float]] = deque(maxlen=FRAMES)  # squares [px^2], and what noise explains

    def add(self, features: StereoFeatures, rig: StereoRig) -> None:
        """Add a frame; one with few tracks says nothing.

        Args:
            features: its points.
            rig: as estimated.
        """
        tracked = features.tracks != 0
        pixels = features.pixels[tracked].astype(float)
        off = rig.epipolar_offset(pixels)
        self._add_step(features.tracks[tracked], pixels, off, rig)
        if len(pixels) < LEAST_POINTS:
            return
        raw_per_px = 1.0 / rig.magnification(pixels)
        smooth = _smooth_terms(pixels[:, :2] / (rig.left.width, rig.left.height)) * raw_per_px[:, None]
        deviation = off - np.median(off)
        right = np.abs(deviation) <= OUTLIER * robust_sigma(deviation)
        off = off - smooth @ np.linalg.lstsq(smooth[right], off[right], rcond=None)[0]
        freedom = 1.0 - smooth.shape[1] / len(off)
        variance = robust_sigma(off) ** 2 / freedom
        self._frames = min(self._frames + 1, FRAMES)
        self._variance_px2 += (variance - self._variance_px2) / self._frames

    def _add_step(self, tracks: NDArray[np.uint32], pixels: Array, off: Array, rig: StereoRig) -> None:
        """Compare the points' distances from their epipolar lines with those in the frame before, by the same rig."""
        _, now, before = np.intersect1d(tracks, self._tracks, return_indices=True)
        change = off[now] - rig.epipolar_offset(self._pixels[before])
        self._tracks, self._pixels = tracks, pixels
        if len(change) >= LEAST_POINTS:
            error = MEDIAN_ERROR * robust_sigma(change) / math.sqrt(len(change))
            self._steps.append((float(np.median(change)) ** 2, error**2))

    def sigma_px(self, configured_px: float) -> float:
        """Return the standard deviation of a right pixel about the left one [px], at least that configured."""
        measured_px = math.sqrt(self._variance_px2 / (1.0 + OFFSET**2))
        return measured_px if measured_px > NOISE_RATIO * configured_px else configured_px

    @property
    def vibration_px(self) -> float:
        """Standard deviation of what all points of an image are off together, independently of other images [px]."""
        if len(self._steps) < LEAST_STEPS:
            return 0.0
        squared, explained = np.median(self._steps, axis=0)
        return math.sqrt(max(0.0, squared / MEDIAN_OF_SQUARES - explained) / 2.0)


def _smooth_terms(at: Array) -> Array:
    """Return (N, 6) polynomials of second order at (N, 2) places in the image."""
    u, v = at.T
    return np.column_stack([np.ones(len(at)), u, v, u * u, u * v, v * v])
