# SPDX-License-Identifier: Apache-2.0
"""How noisy a flight's tracks are, measured by stereo geometry alone: no motion or map, right or wrong, changes it.

With weak texture, noise or compression of the images, tracks scatter more than on the flights that the configured noise
was found on. Their gates are then too narrow: most tracks are refused, the rest are weighted too much, and a right
calibration looks wrong. Across its epipolar line a right pixel is off by this noise and by errors of the calibration,
which are smooth over the image and fitted.
"""

import math

import numpy as np
from numpy.typing import NDArray

from uav_vslam.estimation.past_poses import OFFSET
from uav_vslam.geometry.stereo import StereoRig
from uav_vslam.numerics import robust_sigma
from uav_vslam.types import StereoFeatures

Array = NDArray[np.float64]

LEAST_POINTS = 30  # a frame
FRAMES = 20  # averaged
NOISE_RATIO = 1.5  # measured over configured; below it, what is configured counts


class TrackNoise:
    """Measures the noise of a stream of frames."""

    def __init__(self, rig: StereoRig) -> None:
        self._rig = rig
        self._variance_px2, self._frames = 0.0, 0

    def add(self, features: StereoFeatures) -> None:
        """Add a frame; one with few tracks says nothing."""
        pixels = features.pixels[features.tracks != 0].astype(float)
        if len(pixels) < LEAST_POINTS:
            return
        smooth = _smooth_terms(pixels[:, :2] / (self._rig.left.width, self._rig.left.height))
        off = self._rig.epipolar_offset(pixels)
        off = off - smooth @ np.linalg.lstsq(smooth, off, rcond=None)[0]
        freedom = 1.0 - smooth.shape[1] / len(off)
        variance = robust_sigma(off) ** 2 / freedom
        self._frames = min(self._frames + 1, FRAMES)
        self._variance_px2 += (variance - self._variance_px2) / self._frames

    def sigma_px(self, configured_px: float) -> float:
        """Return the standard deviation of a right pixel about the left one [px], at least that configured."""
        measured_px = math.sqrt(self._variance_px2 / (1.0 + OFFSET**2))
        return measured_px if measured_px > NOISE_RATIO * configured_px else configured_px


def _smooth_terms(at: Array) -> Array:
    """Return (N, 6) polynomials of second order at (N, 2) places in the image."""
    u, v = at.T
    return np.column_stack([np.ones(len(at)), u, v, u * u, u * v, v * v])
