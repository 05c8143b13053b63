# SPDX-License-Identifier: Apache-2.0
"""Removes stereo matches whose disparity is not supported by their neighbours.

The disparity gradient between neighbours on a surface is limited (Pollard, Mayhew, Frisby, "PMF: a stereo
correspondence algorithm using a disparity gradient limit", Perception 1985). The limit is a multiple of the image's
median gradient: tight above flat ground, wide indoors. A match is kept if a few of its neighbours agree with it, not
the majority: a point at the edge of a foreground object is supported by its own side, where a local median would remove
it.
"""

import numpy as np
from numpy.typing import NDArray

from uav_vslam.vision.nearest_points import nearest_points

Array = NDArray[np.float64]

NEIGHBOURS = 12
NEEDED_VOTES = 3
GRADIENT_FACTOR = 3.0  # the limit, in median gradients
LARGEST_GRADIENT = 0.3  # of a surface three baselines away, seen edge-on; above it, outliers support each other


def supported_disparities(pixels: Array, disparity: Array, *, noise_px: float) -> NDArray[np.bool_]:
    """Return which matches have enough neighbours of similar disparity.

    Args:
        pixels: (N, 2) undistorted left pixels.
        disparity: (N,) focal length x baseline / depth [px], defined for any rig, rectified or not.
        noise_px: largest difference of two disparities on one surface due to noise [px].

    Returns:
        (N,) mask.
    """
    count = len(pixels)
    neighbours = min(NEIGHBOURS, count - 1)
    needed = min(NEEDED_VOTES, neighbours // 2)
    if needed <= 0:
        return np.ones(count, bool)
    distance, index = nearest_points(pixels, pixels, neighbours + 1)
    distance, index = distance[:, 1:], index[:, 1:]
    difference = np.abs(disparity[index] - disparity[:, None])
    gradient = GRADIENT_FACTOR * float(np.median(difference / np.maximum(distance, 1.0)))
    limit = noise_px + min(gradient, LARGEST_GRADIENT) * distance
    return np.asarray((difference <= limit).sum(axis=1) >= needed)
