# SPDX-License-Identifier: Apache-2.0
"""Following points from one image to another (Lucas and Kanade 1981; pyramids: Bouguet 2001), by OpenCV.

Lucas-Kanade takes brightness for constant. Cameras that differ in gain and vignette, and an exposure that jumps, break
that: so each image is first freed of its local mean, which costs 1.5 ms at 1280 x 960. With the right camera at gain
1.15 and 35 % vignette that keeps 99.9 % of the points at the same accuracy (without it 90 %, 5 % of them wrong), and an
exposure that jumps by a factor of 1.4 costs 2 % (without it nearly all); dividing by the local standard deviation as
well gains nothing more.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Grey = NDArray[np.uint8]

WINDOW_PX = 15  # 0.055 px of disparity noise; 11: 0.07, 21: 0.043 for 1.3 times the time
MEAN_WINDOW_PX = 127  # 31 would take from the pyramid's upper levels all that they could see
MIDDLE_GREY = 128.0
LEVELS = 5  # of the pyramid: a guess may be about 60 px off
MAX_RETURN_PX = 0.5  # a point that is followed there and back ends so near to where it was, or it was lost
BORDER_PX = 8.0  # half a window: nearer to the border the window shows what is not there
SHIFT_STEP_PX = 8
_ENOUGH = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 20, 0.01)


def without_local_mean(image: Grey) -> Grey:
    """Return an (H, W) image less the mean around each pixel, plus middle grey."""
    mean = cv2.blur(image, (MEAN_WINDOW_PX, MEAN_WINDOW_PX))
    return np.asarray(cv2.addWeighted(image, 1.0, mean, -1.0, MIDDLE_GREY), np.uint8)


def follow(first: Grey, second: Grey, pixels: Array, guess: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Find the points of one image in another, and back again.

    Args:
        first, second: (H, W) images without local mean.
        pixels: (N, 2) points of the first image [px].
        guess: (N, 2) where they may be in the second one [px].

    Returns:
        (N, 2) where they are in the second image, and (N,) which were found there.
    """
    if len(pixels) == 0:
        return np.zeros((0, 2)), np.zeros(0, bool)
    start = np.ascontiguousarray(pixels, np.float32)
    there, seen = _lucas_kanade(first, second, start, np.ascontiguousarray(guess, np.float32), LEVELS)
    back, returned = _lucas_kanade(second, first, there, start, 0)
    good = seen & returned & (np.linalg.norm(back - start, axis=1) <= MAX_RETURN_PX)
    return there.astype(float), good & inside(there, first.shape)


def shift_between(first: Grey, second: Grey) -> Array:
    """Return (2,) by how much the image as a whole has moved [px], by phase correlation of shrunk images."""
    small = [
        cv2.resize(image, None, fx=1 / SHIFT_STEP_PX, fy=1 / SHIFT_STEP_PX, interpolation=cv2.INTER_AREA)
        for image in (first, second)
    ]
    window = cv2.createHanningWindow(small[0].shape[::-1], cv2.CV_32F)
    shift, _ = cv2.phaseCorrelate(small[0].astype(np.float32), small[1].astype(np.float32), window)
    return SHIFT_STEP_PX * np.asarray(shift, float)


def inside(pixels: NDArray[np.floating], shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """Tell which (N, 2) pixels have their whole window inside an image of (height, width)."""
    high = np.array([shape[1], shape[0]]) - 1 - BORDER_PX
    return np.asarray(((pixels >= BORDER_PX) & (pixels <= high)).all(axis=1))


def _lucas_kanade(
    first: Grey, second: Grey, pixels: NDArray[np.float32], guess: NDArray[np.float32], levels: int
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    found, status, _ = cv2.calcOpticalFlowPyrLK(
        first,
        second,
        pixels,
        guess.copy(),  # it is written to
        winSize=(WINDOW_PX, WINDOW_PX),
        maxLevel=levels,
        criteria=_ENOUGH,
        flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
    )
    return np.asarray(found, np.float32), status.ravel().astype(bool) & np.isfinite(found).all(axis=1)
