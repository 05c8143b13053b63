# SPDX-License-Identifier: Apache-2.0
"""How much of what a camera sees at one time it sees at another, from poses and measured points of the scene.

A point of view i counts as seen in view j if it projects into that image and both look at it from similar directions.
Neither a flat ground nor a room is assumed; points that something hides count as seen.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from uav_vslam.geometry.camera import PinholeCamera
from uav_vslam.geometry.pose import Pose

Array = NDArray[np.float64]

BORDER_SAMPLES = 50  # of each side of an image
LARGEST_VIEW_ANGLE_DEG = 50.0  # from there on, SIFT finds less than half of the points again [lowe04, fig. 9]


@dataclass(frozen=True, slots=True)
class View:
    """One image of a flight.

    Attributes:
        stamp_ns: of the image [ns].
        T_world_cam: pose of the left camera.
        points_world: (M, 3) points that the image shows [m].
    """

    stamp_ns: int
    T_world_cam: Pose
    points_world: Array


@dataclass(frozen=True, slots=True)
class Overlap:
    """Pairwise overlap of N views.

    Attributes:
        stamps_ns: (N,) of the views [ns].
        share: (N, N) share of view i's points that view j sees.
        view_angle_deg: (N, N) mean angle between the directions in which i and j look at these points; NaN for none.
        heading_deg: (N, N) absolute difference of the headings.
    """

    stamps_ns: NDArray[np.int64]
    share: Array
    view_angle_deg: Array
    heading_deg: Array

    def __len__(self) -> int:
        return len(self.stamps_ns)


def overlap_of(views: list[View], camera: PinholeCamera) -> Overlap:
    """Compare all views with each other."""
    count = len(views)
    share, angle = np.zeros((count, count)), np.full((count, count), np.nan)
    reach = _reach(camera)
    for row, view in enumerate(views):
        for column, other in enumerate(views):
            share[row, column], angle[row, column] = _seen(view, other, camera, reach)
    stamps_ns = np.array([view.stamp_ns for view in views], np.int64)
    return Overlap(stamps_ns, share, angle, _turns_deg(np.array([view.T_world_cam.R for view in views])))


def _turns_deg(R_world_cam: Array) -> Array:
    """Return (N, N) absolute angles about the vertical between attitudes, whichever way the axes of the body point.

    The part of R = R_i R_j^T about z has the tangent (R_10 - R_01) / (R_00 + R_11).
    """
    R = R_world_cam.reshape(-1, 3, 3)
    relative = np.einsum("iab,jcb->ijac", R, R)
    sine, cosine = relative[..., 1, 0] - relative[..., 0, 1], relative[..., 0, 0] + relative[..., 1, 1]
    return np.asarray(np.degrees(np.abs(np.arctan2(sine, cosine))))


def _reach(camera: PinholeCamera) -> float:
    """Return how far from the axis the lens images, at depth 1: models of lenses fold over beyond."""
    u, v = np.linspace(0, camera.width, BORDER_SAMPLES), np.linspace(0, camera.height, BORDER_SAMPLES)
    zero = np.zeros(BORDER_SAMPLES)
    border = [(u, zero), (u, zero + v[-1]), (zero, v), (zero + u[-1], v)]
    rays = camera.bearings(camera.undistort(np.concatenate([np.column_stack(side) for side in border])))
    return float(np.nanmax(np.linalg.norm(rays[:, :2], axis=1)))


def _seen(view: View, other: View, camera: PinholeCamera, reach: float) -> tuple[float, float]:
    """Return the share of a view's points that the other sees, and the mean angle between their rays [deg]."""
    points = view.points_world
    if len(points) == 0:
        return 0.0, float("nan")
    in_other = other.T_world_cam.inverse().apply(points)
    ahead = in_other[:, 2] > 0
    in_other = np.where(ahead[:, None], in_other, [0.0, 0.0, 1.0])
    ahead &= np.linalg.norm(in_other[:, :2], axis=1) <= reach * in_other[:, 2]
    pixels = camera.distort(camera.project(in_other))
    inside = ahead & np.all((pixels >= 0) & (pixels < camera.size), axis=1)
    rays, other_rays = points - view.T_world_cam.t, points - other.T_world_cam.t
    lengths = np.linalg.norm(rays, axis=1) * np.linalg.norm(other_rays, axis=1)
    cosine = np.einsum("ni,ni->n", rays, other_rays) / np.maximum(lengths, np.finfo(float).tiny)
    angle_deg = np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))
    seen = inside & (angle_deg <= LARGEST_VIEW_ANGLE_DEG)
    return float(seen.mean()), float(angle_deg[seen].mean()) if seen.any() else float("nan")
