# SPDX-License-Identifier: Apache-2.0
"""All matched points, intersected from the adjusted poses: many more than the adjustment itself needs."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from uav_vslam.mapping.pictures.lens import bearings
from uav_vslam.mapping.pictures.picture import Picture
from uav_vslam.mapping.pictures.procedure import Adjusted, centred
from uav_vslam.mapping.pictures.tracks import Tracks

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
    points, angle = intersected(adjusted, tracks)
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
    _, angle = intersected(adjusted, adjusted.tracks)
    fair = angle >= LEAST_ANGLE_RAD
    return adjusted.scene.points[fair] if fair.any() else adjusted.scene.points


def intersected(adjusted: Adjusted, tracks: Tracks) -> tuple[Array, Array]:
    """Return (P, 3) points nearest to their rays, and (P,) typical angles between a point's rays [rad]."""
    scene, picture = adjusted.scene, tracks.picture
    xy = bearings(tracks.pixels, scene.lenses[scene.lens_of[picture]])
    rays = np.einsum("mji,mj->mi", scene.R_cam_map[picture], np.column_stack([xy, np.ones(len(xy))]))
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    across = np.eye(3) - rays[:, :, None] * rays[:, None, :]
    starts = np.searchsorted(tracks.point, np.arange(tracks.count))
    A = np.add.reduceat(across, starts, axis=0)
    b = np.add.reduceat(np.einsum("mij,mj->mi", across, scene.centres[picture]), starts, axis=0)
    number = np.bincount(tracks.point, minlength=tracks.count)
    least = np.linalg.eigvalsh(A)[:, 0] / number  # the mean squared sine of the rays' angles to their mean direction
    points = np.linalg.solve(A + 1e-12 * np.eye(3), b[..., None])[..., 0]
    return np.asarray(points), 2.0 * np.sqrt(np.maximum(least, 0.0))
