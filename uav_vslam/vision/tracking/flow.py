# SPDX-License-Identifier: Apache-2.0
"""Pyramidal KLT optical flow (Lucas and Kanade 1981, Bouguet 2001), by OpenCV.

A point with a good guess is tracked at full resolution alone. Only the others go through the pyramid first, from a
quarter of the resolution up: coarse but cheap. Both ways end at the same minimum, of the full resolution's precision.

Lucas-Kanade assumes constant brightness, which different gains, vignettes and exposure jumps violate. So the local mean
is subtracted from each image first. That is done at full resolution: an enlarged mean would not move with the ground,
and cost 2 % of the precision. With the right camera at gain 1.15 and 35 % vignette this keeps 99.9 % of the points at
the same accuracy (otherwise 90 %, 5 % of them wrong), and an exposure jump by a factor of 1.4 loses 2 % (otherwise
nearly all). Also dividing by the local standard deviation gains nothing.
"""

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from uav_vslam.geometry.plane import similarity_between
from uav_vslam.vision.images import quarter, to_full_resolution, to_shrunk

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Rows = NDArray[np.intp]
Grey = NDArray[np.uint8]

WINDOW_PX = 15  # 0.055 px of disparity noise; 11: 0.07, 21: 0.043 for 1.3 times the time
MEAN_WINDOW_PX = 127  # 31 would remove all texture from the pyramid's upper levels
MIDDLE_GREY = 128.0
COARSE_LEVELS = 3  # of the coarse image's pyramid: tolerates a guess about 60 px off
FAR_PX = 30.0  # a point guessed farther outside the image has left it
NEAR_PX = 1.0  # a point found within it of its guess did not need the pyramid
MAX_RETURN_PX = 0.4  # largest forward-backward error of a tracked point
BORDER_PX = 8.0  # half a window: closer to the border the window is outside the image
FEWEST_TURNED = 8  # points: the guess of fewer tells too little of a turn
LEAST_TURN = 0.035  # [rad], or change of scale: up to 2 degrees interpolation costs more than turning gains
SHIFT_STEP_PX = 2  # of the coarse image
SMOOTHING = np.array([0.25, 0.5, 0.25])  # over neighbouring pixels
_FINE = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 20, 0.01)
_COARSE = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 10, 0.03)


@dataclass(frozen=True)
class FlowImage:
    """An (H, W) image, and what is made of it once it is needed."""

    grey: Grey

    @cached_property
    def full(self) -> Grey:
        """(H, W) without the local mean, around middle grey."""
        return _without_mean(self.grey, MEAN_WINDOW_PX)

    @cached_property
    def coarse(self) -> Grey:
        """About (H / 4, W / 4), without the local mean, too."""
        return _without_mean(quarter(self.grey), MEAN_WINDOW_PX // 4)

    @cached_property
    def smooth(self) -> NDArray[np.float32]:
        """(H, W) grey levels without the noise of single pixels, finer than in whole levels."""
        return np.asarray(cv2.sepFilter2D(self.grey, cv2.CV_32F, SMOOTHING, SMOOTHING), np.float32)

    def warped(self, similarity: Array) -> "FlowImage":
        """Return the image moved by a (2, 3) similarity of pixels; its local mean is that where it has moved."""
        size = self.grey.shape[::-1]
        moved = cv2.warpAffine(self.grey, similarity, size, borderMode=cv2.BORDER_REFLECT_101)
        return FlowImage(np.asarray(moved, np.uint8))

    @property
    def shape(self) -> tuple[int, ...]:
        """Height and width at full resolution [px]."""
        return self.grey.shape


@dataclass(frozen=True)
class Flow:
    """N points of one image that are looked for in another one.

    Attributes:
        first, second: images of one size.
        pixels: (N, 2) points of the first image [px].
        guess: (N, 2) predicted pixels in the second one [px].
    """

    first: FlowImage
    second: FlowImage
    pixels: Array
    guess: Array

    @cached_property
    def turn(self) -> Array | None:
        """(2, 2) turn and change of scale of the image; None if small or unknown.

        Lucas-Kanade moves a window, but does not turn it: over ground that turns by 6 degrees between two images,
        points slide by 0.19 px, and on in the next image. If the first image is turned before: 0.02 px.
        """
        pixels, guess = self._guessed
        A = similarity_between(pixels, guess) if len(pixels) >= FEWEST_TURNED else None
        return None if A is None or np.linalg.norm((A - np.eye(2))[0]) < LEAST_TURN else A

    @property
    def _guessed(self) -> tuple[Array, Array]:
        """The points that have a guess, and these: a lens has no pixel for what is far outside its image."""
        known = np.isfinite(self.guess).all(axis=1)
        return self.pixels[known], self.guess[known]

    @cached_property
    def _turned(self) -> tuple[FlowImage, Array]:
        """The first image and its points, turned like the second image."""
        if self.turn is None:
            return self.first, self.pixels
        pixels, guess = self._guessed
        shift = guess.mean(axis=0) - self.turn @ pixels.mean(axis=0)
        return self.first.warped(np.column_stack([self.turn, shift])), self.pixels @ self.turn.T + shift

    def tracked(self) -> tuple[Array, Mask]:
        """Return (N, 2) pixels in the second image, and (N,) which points are tracked: `track_points`."""
        return self.fine(np.arange(len(self.pixels)), self.guess)

    def coarse(self, rows: Rows) -> Array:
        """Return (K, 2) pixels of K points in the second image, to half a pixel where it shows them."""
        if len(rows) == 0:
            return np.zeros((0, 2))
        first, pixels = self._turned
        return track_coarsely(first, self.second, pixels[rows], self.guess[rows])[0]

    def fine(self, rows: Rows, near: Array) -> tuple[Array, Mask]:
        """Track some of the points, from (K, 2) pixels near to theirs in the second image; result as `tracked`."""
        if len(rows) == 0:
            return np.zeros((0, 2)), np.zeros(0, bool)
        first, pixels = self._turned
        return track_points(first, self.second, pixels[rows], near)


def track_points(first: FlowImage, second: FlowImage, pixels: Array, guess: Array) -> tuple[Array, Mask]:
    """Track points from one image to another, with a forward-backward check.

    Args:
        first, second: images of one size.
        pixels: (N, 2) points of the first image [px].
        guess: (N, 2) predicted pixels in the second one [px].

    Returns:
        (N, 2) pixels in the second image, and the (N,) mask of the points tracked.
    """
    if len(pixels) == 0:
        return np.zeros((0, 2)), np.zeros(0, bool)
    start, near = np.ascontiguousarray(pixels, np.float32), np.ascontiguousarray(guess, np.float32)
    there, seen = _lucas_kanade(first.full, second.full, start, near)
    far = ~(seen & (_distance(there, near) <= NEAR_PX)) & inside(near, first.shape, -FAR_PX)
    if far.any():
        better, _ = track_coarsely(first, second, pixels[far], guess[far])
        there[far], seen[far] = _lucas_kanade(first.full, second.full, start[far], better.astype(np.float32))
    back, returned = _lucas_kanade(second.full, first.full, there, start)
    good = seen & returned & (_distance(back, start) <= MAX_RETURN_PX)
    return there.astype(float), good & inside(there, first.shape)


def track_coarsely(first: FlowImage, second: FlowImage, pixels: Array, guess: Array) -> tuple[Array, Mask]:
    """Track points through the pyramid down to a quarter of the resolution; arguments and result as `track_points`.

    The result is within half a pixel, without a check; where tracking fails, the pixel is the guess.
    """
    full, coarse = first.shape, first.coarse.shape
    start, near = (to_shrunk(points, coarse, full).astype(np.float32) for points in (pixels, guess))
    there, seen = _lucas_kanade(first.coarse, second.coarse, start, near, COARSE_LEVELS, _COARSE)
    return np.where(seen[:, None], to_full_resolution(there, coarse, full), guess), seen


def shift_between(first: FlowImage, second: FlowImage) -> Array:
    """Return the (2,) global shift of the image [px], by phase correlation of downscaled images."""
    scale = 1 / SHIFT_STEP_PX
    small = [
        cv2.resize(image.coarse, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA) for image in (first, second)
    ]
    window = cv2.createHanningWindow(small[0].shape[::-1], cv2.CV_32F)
    shift, _ = cv2.phaseCorrelate(small[0].astype(np.float32), small[1].astype(np.float32), window)
    return np.asarray(shift, float) * first.shape[::-1] / small[0].shape[::-1]


def inside(pixels: NDArray[np.floating], shape: tuple[int, ...], border_px: float = BORDER_PX) -> Mask:
    """Return which (N, 2) pixels are inside an image of (height, width), by default with their window."""
    high = np.array([shape[1], shape[0]]) - 1 - border_px
    return np.asarray(((pixels >= border_px) & (pixels <= high)).all(axis=1))


def _distance(a: NDArray[np.float32], b: NDArray[np.float32]) -> NDArray[np.float32]:
    return np.asarray(np.hypot(*(a - b).T))


def _without_mean(image: Grey, window_px: int) -> Grey:
    mean = cv2.blur(image, (window_px, window_px))
    return np.asarray(cv2.addWeighted(image, 1.0, mean, -1.0, MIDDLE_GREY), np.uint8)


def _lucas_kanade(
    first: Grey,
    second: Grey,
    pixels: NDArray[np.float32],
    guess: NDArray[np.float32],
    levels: int = 0,
    enough: tuple[int, int, float] = _FINE,
) -> tuple[NDArray[np.float32], Mask]:
    found, status, _ = cv2.calcOpticalFlowPyrLK(
        first,
        second,
        pixels,
        guess.copy(),  # OpenCV modifies it
        winSize=(WINDOW_PX, WINDOW_PX),
        maxLevel=levels,
        criteria=enough,
        flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
    )
    return np.asarray(found, np.float32), status.ravel().astype(bool) & np.isfinite(found).all(axis=1)
