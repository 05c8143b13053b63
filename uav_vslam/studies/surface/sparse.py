# SPDX-License-Identifier: Apache-2.0
"""The thesis's surfaces, for comparison: a Delaunay triangulation of landmarks (5.4), with extra points (5.6.1).

Extra points lie on a lattice of the left image. A homography of the matched features predicts them in the right one
of the same pair; deviation: image alignment refines the prediction, which alone would put all of them on one plane.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import LinearNDInterpolator

from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.stereo import StereoRig
from uav_vslam.mapping.raster import Raster
from uav_vslam.types import StereoFeatures

Array = NDArray[np.float64]
Grey = NDArray[np.uint8]

LEAST_VIEWS = 3  # of a landmark
LEAST_ANGLE_DEG = 1.0  # between the first and the last ray
LARGEST_MISS_RAD = 1e-3  # root mean square distance of the rays from their point, seen from the camera
LATTICE_PX = 32
BORDER_PX = 16
PATCH_PX, LEVELS = 21, 1
LARGEST_PARALLAX_PX = 5.0  # from the prediction: farther ones are wrong matches
EPIPOLAR_PX = 0.5
LEAST_FEATURES = 8
HOMOGRAPHY_PX = 3.0


@dataclass(frozen=True, slots=True)
class DelaunaySurface:
    """Heights between points, linear over the triangles of their plan view.

    Attributes:
        points: (N, 3) in the map frame [m].
    """

    points: Array

    def height(self, raster: Raster) -> NDArray[np.float32]:
        """Return the (rows, columns) heights of a window [m], NaN outside of the triangulation."""
        if len(self.points) < 4:
            return np.full(raster.shape, np.nan, np.float32)
        x, y = np.meshgrid(raster.x, raster.y)
        return np.asarray(LinearNDInterpolator(self.points[:, :2], self.points[:, 2])(x, y), np.float32)


def landmarks(features: Sequence[StereoFeatures], poses: Mapping[int, Pose], rig: StereoRig) -> Array:
    """Return (N, 3) points where the left rays of each feature track meet, in the map frame [m].

    Args:
        features: of a flight, with tracks.
        poses: T_map_body by stamp [ns]; frames without one are left out.
        rig: calibration.
    """
    seen = [frame for frame in features if frame.stamp_ns in poses and (frame.tracks > 0).any()]
    if not seen:
        return np.zeros((0, 3))
    ids, rays, centres = [], [], []
    for frame in seen:
        T_map_left, tracked = poses[frame.stamp_ns] @ rig.T_body_left, frame.tracks > 0
        bearings = rig.left.bearings(frame.pixels[tracked, :2]) @ T_map_left.R.T
        ids.append(frame.tracks[tracked])
        rays.append(bearings / np.linalg.norm(bearings, axis=1, keepdims=True))
        centres.append(np.broadcast_to(T_map_left.t, bearings.shape))
    return _intersections(np.concatenate(ids), np.concatenate(rays), np.concatenate(centres))


def _intersections(ids: NDArray[np.uint32], rays: Array, centres: Array) -> Array:
    """Return the point nearest to all rays of each id, where they have enough of an angle and meet well."""
    _, first, owner, count = np.unique(ids, return_index=True, return_inverse=True, return_counts=True)
    last = len(ids) - 1 - np.unique(ids[::-1], return_index=True)[1]
    angle = np.einsum("ni,ni->n", rays[first], rays[last])
    wide = (count >= LEAST_VIEWS) & (angle < np.cos(np.deg2rad(LEAST_ANGLE_DEG)))
    across = np.eye(3) - rays[:, :, None] * rays[:, None, :]
    normal, right = np.zeros((len(count), 3, 3)), np.zeros((len(count), 3))
    np.add.at(normal, owner, across)
    np.add.at(right, owner, np.einsum("nij,nj->ni", across, centres))
    normal[~wide] = np.eye(3)
    points = np.linalg.solve(normal, right[..., None])[..., 0]
    towards = points[owner] - centres
    miss = np.linalg.norm(np.einsum("nij,nj->ni", across, towards), axis=1) / np.linalg.norm(towards, axis=1)
    mean_square = np.bincount(owner, weights=miss**2) / count
    return np.asarray(points[wide & (mean_square < LARGEST_MISS_RAD**2)])


def extra_points(left: Grey, right: Grey, features: StereoFeatures, T_map_body: Pose, rig: StereoRig) -> Array:
    """Return (N, 3) lattice points of one stereo pair in the map frame [m].

    Args:
        left, right: (H, W) images without distortion.
        features: of the pair.
        T_map_body: pose.
        rig: calibration.
    """
    if len(features) < LEAST_FEATURES:
        return np.zeros((0, 3))
    H, _ = cv2.findHomography(
        features.pixels[:, :2].astype(float), features.pixels[:, 2:].astype(float), cv2.RANSAC, HOMOGRAPHY_PX
    )
    if H is None:
        return np.zeros((0, 3))
    height, width = left.shape
    u, v = np.meshgrid(np.arange(BORDER_PX, width, LATTICE_PX), np.arange(BORDER_PX, height, LATTICE_PX))
    lattice = np.stack([u, v], axis=-1).reshape(-1, 1, 2).astype(np.float32)
    predicted = cv2.perspectiveTransform(lattice, H)
    found, good, _ = cv2.calcOpticalFlowPyrLK(
        left,
        right,
        lattice,
        predicted.copy(),
        winSize=(PATCH_PX, PATCH_PX),
        maxLevel=LEVELS,
        flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
    )
    near = np.linalg.norm(found - predicted, axis=-1) < LARGEST_PARALLAX_PX
    pixels = np.hstack([lattice[:, 0], found[:, 0]]).astype(float)[near[:, 0] & (good[:, 0] > 0)]
    pixels = pixels[rig.epipolar_distance(pixels) < EPIPOLAR_PX]
    points = rig.triangulate(pixels)
    return (T_map_body @ rig.T_body_left).apply(points[np.isfinite(points).all(axis=1)])
