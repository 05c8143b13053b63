# SPDX-License-Identifier: Apache-2.0
"""Prediction of tracked points: in the next left image by the last flow, in the right one by their depth.

The front end does without IMU: an affine model of the last image motion is wrong by the change of rotation between two
images, 20 to 80 px in turbulence. A sample of points, tracked coarsely, gives a homography, which is right within a
pixel for distant ground and any rotation; the pyramid tolerates the rest.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

from uav_vslam.geometry.stereo import StereoRig
from uav_vslam.vision.tracking.flow import FlowImage, track_coarsely

Array = NDArray[np.float64]

MIN_POINTS = 8  # fewer do not determine the flow
OUTLIER_FACTOR = 3.0  # times the median distance from the first fit
SAMPLE = 40  # points that determine the homography
SAMPLE_PX = 3.0  # from the homography: more is parallax, or wrong
MIN_SHARE = 0.5  # of the sample on the homography
TRIALS = 100  # of RANSAC: one in sixteen has no outlier if half the sample are


class FlowModel:
    """The image motion per second as an affine function of the pixel."""

    def __init__(self) -> None:
        self._velocity = np.zeros((3, 2))  # [px/s], for (u, v, 1)

    def fit(self, before: Array, after: Array, dt_s: float) -> None:
        """Fit the motion of (N, 2) pixels over `dt_s`; zero flow if there are too few."""
        if len(before) < MIN_POINTS:
            self._velocity = np.zeros((3, 2))
            return
        velocity = (after - before) / dt_s
        A = _homogeneous(before)
        initial = np.linalg.lstsq(A, velocity, rcond=None)[0]
        distance = np.linalg.norm(velocity - A @ initial, axis=1)
        near = distance <= OUTLIER_FACTOR * np.median(distance)
        self._velocity = np.linalg.lstsq(A[near], velocity[near], rcond=None)[0]

    def predict(self, pixels: Array, dt_s: float) -> Array:
        """Predict (N, 2) pixels after `dt_s`."""
        return np.asarray(pixels + _homogeneous(pixels) @ self._velocity * dt_s)


def by_homography(first: FlowImage, second: FlowImage, pixels: Array, guess: Array) -> Array | None:
    """Predict (N, 2) pixels in the second image from a sample of them; None if no homography fits half of it.

    Args:
        first, second: consecutive images.
        pixels: (N, 2) points of the first one [px].
        guess: (N, 2) first guess, some 60 px off at most [px].
    """
    rows = np.unique(np.linspace(0, len(pixels) - 1, min(SAMPLE, len(pixels))).astype(np.intp))
    if len(rows) < MIN_POINTS:
        return None
    found, seen = track_coarsely(first, second, pixels[rows], guess[rows])
    if seen.sum() < max(MIN_POINTS, MIN_SHARE * len(rows)):
        return None
    H, inliers = cv2.findHomography(pixels[rows[seen]], found[seen], cv2.RANSAC, SAMPLE_PX, maxIters=TRIALS)
    if H is None or inliers.sum() < MIN_SHARE * len(rows):
        return None
    return cv2.perspectiveTransform(pixels[None], H)[0]


def in_right_image(rig: StereoRig, pixels_left: Array, depth_m: Array) -> Array:
    """Return the (N, 2) raw right pixels of (N, 2) raw left ones at depths of (N,) metres."""
    points_left = rig.left.bearings(rig.left.undistort(pixels_left)) * depth_m[:, None]
    return rig.right.distort(rig.project(points_left)[:, 2:])


def _homogeneous(pixels: Array) -> Array:
    return np.hstack([pixels, np.ones((len(pixels), 1))])
