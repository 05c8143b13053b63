# SPDX-License-Identifier: Apache-2.0
"""Prediction of tracked points: in the next left image by the last flow, in the right one by their depth.

The front end does without IMU: an affine model of the last image motion is wrong only by the change of rotation between
two images, which the pyramid tolerates.
"""

import numpy as np
from numpy.typing import NDArray

from uav_vslam.geometry.stereo import StereoRig

Array = NDArray[np.float64]

MIN_POINTS = 8  # fewer do not determine the flow
OUTLIER_FACTOR = 3.0  # times the median distance from the first fit


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


def in_right_image(rig: StereoRig, pixels_left: Array, depth_m: Array) -> Array:
    """Return the (N, 2) raw right pixels of (N, 2) raw left ones at depths of (N,) metres."""
    points_left = rig.left.bearings(rig.left.undistort(pixels_left)) * depth_m[:, None]
    return rig.right.distort(rig.project(points_left)[:, 2:])


def _homogeneous(pixels: Array) -> Array:
    return np.hstack([pixels, np.ones((len(pixels), 1))])
