# SPDX-License-Identifier: Apache-2.0
"""Points from the rays of known cameras."""

import numpy as np
from numpy.typing import NDArray

from uav_vslam.mapping.pictures.bundle import Scene
from uav_vslam.mapping.pictures.lens import bearings
from uav_vslam.mapping.pictures.tracks import Tracks

Array = NDArray[np.float64]


def rays(scene: Scene, tracks: Tracks) -> Array:
    """Return the (M, 3) unit vectors from the cameras to what they observed, in the map frame."""
    xy = bearings(tracks.pixels, scene.lenses[scene.lens_of[tracks.picture]])
    directions = np.einsum("mji,mj->mi", scene.R_cam_map[tracks.picture], np.column_stack([xy, np.ones(len(xy))]))
    return np.asarray(directions / np.linalg.norm(directions, axis=1, keepdims=True))


def triangulated(scene: Scene, tracks: Tracks) -> tuple[Array, Array]:
    """Return (P, 3) points nearest to their rays, and (P,) typical angles between a point's rays [rad].

    Args:
        scene: cameras; its points are not used.
        tracks: in pixels from the images' centres.
    """
    towards = rays(scene, tracks)
    across = np.eye(3) - towards[:, :, None] * towards[:, None, :]
    starts = np.searchsorted(tracks.point, np.arange(tracks.count))
    A = np.add.reduceat(across, starts, axis=0)
    b = np.add.reduceat(np.einsum("mij,mj->mi", across, scene.centres[tracks.picture]), starts, axis=0)
    number = np.bincount(tracks.point, minlength=tracks.count)
    least = np.linalg.eigvalsh(A)[:, 0] / number  # the mean squared sine of the rays' angles to their mean direction
    points = np.linalg.solve(A + 1e-12 * np.eye(3), b[..., None])[..., 0]
    return np.asarray(points), 2.0 * np.sqrt(np.maximum(least, 0.0))
