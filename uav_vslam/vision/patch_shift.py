# SPDX-License-Identifier: Apache-2.0
"""How far two patches that show the same are apart, to a twentieth of a pixel.

Phase correlation finds the shift to a pixel or so, and small ones too small: 0.17 instead of 0.3 px over farmland. The
shift with the best correlation coefficient [evangelidis08] follows from there.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Real = NDArray[np.float32]

FARTHEST_PX = 2.0  # of the two answers from each other
LEAST_CORRELATION = 0.6
SMOOTHING_PX = 5
UNTIL = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 30, 1e-4)


def patch_shift(first: Real, second: Real) -> Array | None:
    """Return the (2,) shift of the second patch [px], along columns and rows; None if they do not show the same.

    Args:
        first, second: (rows, columns) grey levels.
    """
    window = cv2.createHanningWindow(first.shape[::-1], cv2.CV_32F)
    # It changes what it is given, and a mean would correlate through the window alone.
    near, _ = cv2.phaseCorrelate(first - first.mean(), second - second.mean(), window)
    warp = np.array([[1.0, 0.0, near[0]], [0.0, 1.0, near[1]]], np.float32)
    try:
        correlation, warp = cv2.findTransformECC(first, second, warp, cv2.MOTION_TRANSLATION, UNTIL, None, SMOOTHING_PX)
    except cv2.error:  # no convergence
        return None
    shift = np.asarray(warp[:, 2], float)
    agrees = correlation >= LEAST_CORRELATION and np.hypot(*(shift - near)) <= FARTHEST_PX
    return shift if agrees else None
