# SPDX-License-Identifier: Apache-2.0
"""Camera pose from mapped points and their pixels, robust to wrong matches."""

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from uav_vslam.geometry.camera import PinholeCamera
from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.rotation import so3_exp, so3_log

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

MIN_POINTS = 4
ITERATIONS = 300
CONFIDENCE = 0.999
REFINEMENTS = 3  # rounds of refit and re-selection of the inliers


def pnp_ransac(
    points_map: ArrayLike,
    pixels_left: ArrayLike,
    camera: PinholeCamera,
    guess: Pose | None = None,
    *,
    threshold_px: float,
) -> tuple[Pose, Mask] | None:
    """Find the pose with the largest consensus of reprojections.

    The better of RANSAC's (P3P) and the guess's consensus, each refitted by Levenberg-Marquardt. OpenCV's RANSAC has a
    fixed seed: the same input always gives the same result.

    Args:
        points_map: (N, 3) mapped points [m].
        pixels_left: (N, 2) undistorted pixels.
        camera: intrinsics of the left camera.
        guess: predicted T_map_left, or None.
        threshold_px: largest reprojection error of an inlier [px].

    Returns:
        T_map_left and the (N,) inlier mask, or None if no pose has at least 4 inliers.
    """
    points = np.asarray(points_map, float).reshape(-1, 3)
    pixels = np.asarray(pixels_left, float).reshape(-1, 2)
    if len(points) < MIN_POINTS:
        return None
    T_guess_map = None if guess is None else guess.inverse()
    starts = [_ransac(points, pixels, camera, threshold_px=threshold_px), T_guess_map]
    fits = [_refine(points, pixels, camera, T, threshold_px=threshold_px) for T in starts if T is not None]
    found = [fit for fit in fits if fit is not None]
    if not found:
        return None
    T_left_map, inliers = max(found, key=lambda fit: int(fit[1].sum()))
    return T_left_map.inverse(), inliers


def _ransac(points: Array, pixels: Array, camera: PinholeCamera, *, threshold_px: float) -> Pose | None:
    """Return T_left_map with the largest consensus over random samples of four, or None.

    Of OpenCV's result only the consensus is used: it refits the pose to it by EPnP, which over flat ground may return
    one that is 0.4 rad off. SQPnP has no such ambiguity.
    """
    try:
        found, _, _, consensus = cv2.solvePnPRansac(
            points,
            pixels,
            camera.K,
            None,
            iterationsCount=ITERATIONS,
            reprojectionError=threshold_px,
            confidence=CONFIDENCE,
            flags=cv2.SOLVEPNP_AP3P,
        )
        if not found:
            return None
        rows = consensus.ravel()
        found, rotation_vector, translation = cv2.solvePnP(
            points[rows], pixels[rows], camera.K, None, flags=cv2.SOLVEPNP_SQPNP
        )
    except cv2.error:  # degenerate points: OpenCV fails an assertion
        return None
    return _pose(rotation_vector, translation) if found else None


def _refine(
    points: Array, pixels: Array, camera: PinholeCamera, T_left_map: Pose, *, threshold_px: float
) -> tuple[Pose, Mask] | None:
    """Alternate between refitting to the inliers and selecting them; None with fewer than 4 inliers."""
    inliers = _inliers(points, pixels, camera, T_left_map, threshold_px)
    for _ in range(REFINEMENTS):
        if inliers.sum() < MIN_POINTS:
            return None
        rotation_vector, translation = cv2.solvePnPRefineLM(
            points[inliers], pixels[inliers], camera.K, None, so3_log(T_left_map.R), T_left_map.t.copy()
        )
        refitted = _pose(rotation_vector, translation)
        selected = _inliers(points, pixels, camera, refitted, threshold_px)
        if selected.sum() < inliers.sum():
            break
        unchanged = bool(np.array_equal(selected, inliers))
        T_left_map, inliers = refitted, selected
        if unchanged:
            break
    return T_left_map, inliers


def _inliers(points: Array, pixels: Array, camera: PinholeCamera, T_left_map: Pose, threshold_px: float) -> Mask:
    points_left = T_left_map.apply(points)
    ahead = points_left[:, 2] > 0
    safe = np.where(ahead[:, None], points_left, [0.0, 0.0, 1.0])
    error = np.linalg.norm(camera.project(safe) - pixels, axis=1)
    return np.asarray(ahead & (error <= threshold_px))


def _pose(rotation_vector: NDArray[np.generic], translation: NDArray[np.generic]) -> Pose:
    return Pose(so3_exp(np.ravel(rotation_vector)), np.asarray(np.ravel(translation), float))
