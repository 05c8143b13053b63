# SPDX-License-Identifier: Apache-2.0
"""Two views of the ground, turned and shifted so that a point at the reference height has disparity zero.

Axes of a rectified pair: x along the baseline, z as far down as that allows (or along the cameras, if they look
obliquely). Down makes depth a height, so that a level ground needs few disparities however the vehicle banks.
In it a point at depth Z has the disparity f B / Z, with focal length f [px] and baseline B [m].
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from uav_vslam.geometry.pose import Pose
from uav_vslam.mapping.surface.prepared import Grey, PreparedView

Array = NDArray[np.float64]
Floats = NDArray[np.float32]

DOWN = np.array([0.0, 0.0, -1.0])
OBLIQUE = 0.77  # cosine of the angle from the vertical, 40 degrees, beyond which depth is along the cameras
STEEPEST_BASELINE = 0.6  # part of the baseline along the viewing direction
FLATTEST_RAY = 0.3  # least depth of a corner's ray of unit length
DISPARITY_STEP = 16  # OpenCV searches multiples of it
MARGIN_PX = 24  # around a region: blocks, and ground higher or lower than the middle
BLOCK_PX = 5  # side of the blocks that are compared
LARGEST_PX = 4096  # side of a rectified image


@dataclass(frozen=True, slots=True)
class Depths:
    """Heights in the map frame between which the surface is searched, low < middle < high [m]."""

    low_m: float
    middle_m: float
    high_m: float


@dataclass(frozen=True, slots=True)
class RectifiedPair:
    """The geometry of a rectified pair.

    Attributes:
        left, right: the views.
        R_map_rect: (3, 3) rectified axes in the map frame.
        baseline_m: distance of the two cameras.
        focal_px: of both rectified images.
        corner_px: (2,) of the left window: x f / z and y f / z of its first pixel.
        size: width and height of both windows [px].
        shift_px: disparity at the reference depth, which the windows take out.
        first, count: of the searched disparities, after the shift.
    """

    left: PreparedView
    right: PreparedView
    R_map_rect: Array
    baseline_m: float
    focal_px: float
    corner_px: Array
    size: tuple[int, int]
    shift_px: float
    first: int
    count: int

    def images(self) -> tuple[Grey, Grey]:
        """Return both rectified images; 0 outside of the views, where no grey level inside is 0."""
        left = self._warped(self.left, 0.0)
        return left, self._warped(self.right, self.shift_px)

    def points_map(self, disparity_px: Floats, chosen: NDArray[np.bool_]) -> Floats:
        """Return (N, 3) points in the map frame [m] of some pixels of the left window, each axis contiguous.

        Args:
            disparity_px: (H, W) of the window.
            chosen: (H, W) which; each lies in front of the camera.
        """
        width, height = self.size
        x = ((np.arange(width) + self.corner_px[0]) / self.focal_px).astype(np.float32)
        y = ((np.arange(height) + self.corner_px[1]) / self.focal_px).astype(np.float32)[:, None]
        depth = np.float32(self.focal_px * self.baseline_m) / (disparity_px[chosen] + np.float32(self.shift_px))
        R, t = self.R_map_rect.astype(np.float32), self.left.T_map_cam.t.astype(np.float32)
        points = np.empty((3, len(depth)), np.float32)
        for axis in range(3):
            points[axis] = t[axis] + depth * (R[axis, 0] * x + (R[axis, 1] * y + R[axis, 2]))[chosen]
        return points.T

    def _warped(self, view: PreparedView, shift_px: float) -> Grey:
        K = np.array(
            [
                [self.focal_px, 0.0, shift_px - self.corner_px[0]],
                [0.0, self.focal_px, -self.corner_px[1]],
                [0.0, 0.0, 1.0],
            ]
        )
        H = K @ self.R_map_rect.T @ view.T_map_cam.R @ np.linalg.inv(view.camera.K)
        bright = np.maximum(view.grey, 1)
        # Pixels that mix with the border would look like a texture of the ground: they are left out.
        image = cv2.warpPerspective(bright, H, self.size, flags=cv2.INTER_LINEAR)
        inside = cv2.warpPerspective(np.full(bright.shape, 255, np.uint8), H, self.size, flags=cv2.INTER_LINEAR)
        image[inside < 255] = 0
        return np.asarray(image)


def rectify(
    left: PreparedView,
    right: PreparedView,
    depths: Depths,
    *,
    most: int,
    overlap: float,
    region: Array | None = None,
) -> RectifiedPair | None:
    """Rectify two views; None where their geometry does not allow a match.

    Args:
        left, right: the views; the baseline is from left to right.
        depths: heights to search.
        most: largest number of disparities.
        overlap: least share of the left view that the right one shows too.
        region: (N, 3) points in the map frame whose surroundings are wanted; None for all that both show.
    """
    across = right.T_map_cam.t - left.T_map_cam.t
    baseline_m = float(np.linalg.norm(across))
    R = _axes(across / max(baseline_m, 1e-9), left.T_map_cam, right.T_map_cam)
    if R is None:
        return None
    corners = [_corners(view, R) for view in (left, right)]
    near, middle, far = _depths(left, corners[0] @ R.T, depths, R)
    if min(rays[:, 2].min() for rays in corners) < FLATTEST_RAY or not 0.0 < near < middle < far:
        return None
    focal_px = 0.5 * (left.camera.fx + left.camera.fy)
    shift_px = focal_px * baseline_m / middle
    boxes = [focal_px * rays[:, :2] / rays[:, 2:] for rays in corners]
    start, end, share = _common(boxes[0], boxes[1] + [shift_px, 0.0])
    if share < overlap:
        return None
    if region is not None:
        points = (region - left.T_map_cam.t) @ R
        wanted = focal_px * points[:, :2] / points[:, 2:]
        start = np.maximum(start, wanted.min(axis=0) - MARGIN_PX)
        end = np.minimum(end, wanted.max(axis=0) + MARGIN_PX)
    first = int(np.floor(focal_px * baseline_m / far - shift_px)) - 1
    last = int(np.ceil(focal_px * baseline_m / near - shift_px)) + 1
    count = min(-(-(last - first) // DISPARITY_STEP) * DISPARITY_STEP, most)
    first = last - count
    # OpenCV finds nothing along these two edges.
    corner_px = np.floor(start - np.array([max(last, 0), 0.0]))
    width, height = np.ceil(end + np.array([max(-first, 0), 0.0]) - corner_px).astype(int).tolist()
    if max(width, height) > LARGEST_PX or width <= count + BLOCK_PX or height <= BLOCK_PX:
        return None
    return RectifiedPair(left, right, R, baseline_m, focal_px, corner_px, (width, height), shift_px, first, count)


def _common(left: Array, right: Array) -> tuple[Array, Array, float]:
    """Return the common box of two sets of (4, 2) corners, and its share of the left one's box."""
    start = np.maximum(left.min(axis=0), right.min(axis=0))
    end = np.minimum(left.max(axis=0), right.max(axis=0))
    return start, end, float(np.prod(np.maximum(end - start, 0.0)) / np.prod(np.ptp(left, axis=0)))


def _axes(along: Array, left: Pose, right: Pose) -> Array | None:
    """Return R_map_rect; None for a baseline along the viewing direction."""
    looking = left.R[:, 2] + right.R[:, 2]
    looking = looking / max(float(np.linalg.norm(looking)), 1e-9)
    z = DOWN if looking @ DOWN > OBLIQUE else looking
    if abs(z @ along) > STEEPEST_BASELINE:
        return None
    z = z - along * (along @ z)
    z = z / np.linalg.norm(z)
    return np.column_stack([along, np.cross(z, along), z])


def _corners(view: PreparedView, R_map_rect: Array) -> Array:
    """Return (4, 3) unit rays through the corners of the image in rectified axes."""
    u, v = view.camera.width - 1.0, view.camera.height - 1.0
    rays = view.camera.bearings(np.array([[0.0, 0.0], [u, 0.0], [u, v], [0.0, v]]))
    rays = rays @ view.T_map_cam.R.T @ R_map_rect
    return np.asarray(rays / np.linalg.norm(rays, axis=1, keepdims=True))


def _depths(view: PreparedView, rays_map: Array, depths: Depths, R_map_rect: Array) -> tuple[float, float, float]:
    """Return the least depth of the highest surface, the middle one's mean depth, and the largest of the lowest [m].

    Args:
        view: its camera is above all of the surface.
        rays_map: (4, 3) rays through the image's corners in the map frame.
        depths: heights of the surface.
        R_map_rect: rectified axes.
    """
    fall = np.maximum(-rays_map[:, 2], FLATTEST_RAY)
    per_metre = (rays_map @ R_map_rect[:, 2]) / fall  # depth for each metre of height
    above = view.T_map_cam.t[2] - np.array([depths.high_m, depths.middle_m, depths.low_m])
    near, middle, far = above * [per_metre.min(), per_metre.mean(), per_metre.max()]
    return float(near), float(middle), float(far)
