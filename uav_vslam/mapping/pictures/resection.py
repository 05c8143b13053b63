# SPDX-License-Identifier: Apache-2.0
"""A picture's pose from points of a scene, and which observations the scene explains."""

from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from uav_vslam.mapping.pictures.bundle import Scene
from uav_vslam.mapping.pictures.lens import camera_of
from uav_vslam.mapping.pictures.tracks import Tracks
from uav_vslam.numerics import robust_sigma

REJECT = 4.0  # robust sigmas above which an observation is false
FEWEST_POINTS = 12  # that must hold a picture
PNP_SHARE = 3e-3  # reprojection error of points that agree / longest side


def explained(scene: Scene, tracks: Tracks, most_px: float) -> NDArray[np.bool_]:
    """Return which (M,) observations are met, in front of their cameras; `most_px` was Huber's bound."""
    residuals = scene.residuals(tracks)
    bound = max(REJECT * robust_sigma(residuals), 0.5 * most_px)
    return np.asarray((np.linalg.norm(residuals, axis=1) <= bound) & (scene.in_camera(tracks)[:, 2] > 0.0))


def resected(
    scene: Scene, tracks: Tracks, picture: int, size: tuple[int, int], *, share: float = PNP_SHARE
) -> Scene | None:
    """Return the scene with one picture's pose from its points (PnP); None if too few agree.

    Args:
        scene: with points.
        tracks: in pixels from the images' centres.
        picture: its number.
        size: width and height of its image [px].
        share: reprojection error of points that agree / longest side.
    """
    own = np.flatnonzero(tracks.picture == picture)
    if len(own) < FEWEST_POINTS:
        return None
    camera = camera_of(scene.lenses[scene.lens_of[picture]], *size)
    pixels = tracks.pixels[own] + 0.5 * (np.array(size) - 1.0)
    found, turn, shift, inliers = cv2.solvePnPRansac(
        scene.points[tracks.point[own]], pixels, camera.K, camera.distortion, reprojectionError=share * max(size)
    )
    if not found or inliers is None or len(inliers) < FEWEST_POINTS:
        return None
    R_cam_map = cv2.Rodrigues(turn)[0]
    attitudes, centres = scene.R_cam_map.copy(), scene.centres.copy()
    attitudes[picture], centres[picture] = R_cam_map, -R_cam_map.T @ shift.ravel()
    return replace(scene, R_cam_map=attitudes, centres=centres)
