# SPDX-License-Identifier: Apache-2.0
"""All matched points, triangulated from the adjusted poses: many more than the adjustment itself needs."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from uav_vslam.mapping.pictures.picture import Picture
from uav_vslam.mapping.pictures.procedure import Adjusted, centred
from uav_vslam.mapping.pictures.tracks import Tracks
from uav_vslam.mapping.pictures.triangulation import triangulated

Array = NDArray[np.float64]

MOST_SIGMAS = 4.0  # of reprojection error of an accepted observation
LEAST_ANGLE_RAD = 0.05  # between the rays to a point; less tells no height


def all_points(adjusted: Adjusted, tracks: Tracks, pictures: Sequence[Picture]) -> Array:
    """Return (P, 3) points of all tracks that the poses explain, with rays at a fair angle.

    Args:
        adjusted: poses and lenses.
        tracks: all of them, in pixels.
        pictures: all of the folder.
    """
    tracks = centred(tracks.chosen(np.isin(tracks.picture, adjusted.used)), pictures)
    points, angle = triangulated(adjusted.scene, tracks)
    scene = replace(adjusted.scene, points=points)
    error = np.linalg.norm(scene.residuals(tracks), axis=1)
    error[scene.in_camera(tracks)[:, 2] <= 0.0] = np.inf
    worst = np.zeros(tracks.count)
    np.maximum.at(worst, tracks.point, error)
    return np.asarray(points[(worst <= MOST_SIGMAS * adjusted.noise_px) & (angle >= LEAST_ANGLE_RAD)])


def ground_points(adjusted: Adjusted) -> Array:
    """Return those (P, 3) points of the scene with rays at a fair angle; all, if there are none.

    The others lie anywhere along their rays: two cameras on one vehicle take pictures from almost the same place.
    """
    _, angle = triangulated(adjusted.scene, adjusted.tracks)
    fair = angle >= LEAST_ANGLE_RAD
    return adjusted.scene.points[fair] if fair.any() else adjusted.scene.points
