# SPDX-License-Identifier: Apache-2.0
"""Height of the ground from the adjusted points: outliers removed, interpolated over triangles, smoothed.

Beyond the points the surface goes on at the height of those nearest, smoothed far more, so that the pictures' edges are
drawn too.
"""

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import LinearNDInterpolator, NearestNDInterpolator
from scipy.spatial import cKDTree

from uav_vslam.errors import PictureError
from uav_vslam.mapping.raster import Raster
from uav_vslam.numerics import NORMAL_MAD

Array = NDArray[np.float64]

NEIGHBOURS = 12
OUTLIER = 4.0  # robust sigmas from the neighbours' median
CELLS_PER_POINT = 1.5  # along each axis; the grid is about as fine as the points are dense
CELLS = 40, 1000  # fewest and most along the longer side of the points
SMOOTH_CELLS, SMOOTH_BEYOND_CELLS = 1.0, 12.0
FEWEST = 12
MARGIN = 0.35  # of the points' extent around them, at least


class PointSurface:
    """A smooth surface through scattered points."""

    def __init__(self, points: Array, *, picture_m: float = 0.0) -> None:
        """Build the grid.

        Args:
            points: (P, 3) in the map frame.
            picture_m: longest side of a picture on the ground [m], by which it may reach beyond the points.

        Raises:
            PictureError: there are too few points.
        """
        points = without_outliers(points)
        if len(points) < FEWEST:
            raise PictureError(
                f"{len(points)} points of the ground are too few for a surface; pictures overlap too little, or were "
                "all taken from one place, which shows no heights"
            )
        extent = float(np.ptp(points[:, :2], axis=0).max())
        margin_m = max(MARGIN * extent, picture_m)
        around = [points[:, :2].min(axis=0) - margin_m, points[:, :2].max(axis=0) + margin_m]
        cells = float(np.clip(CELLS_PER_POINT * np.sqrt(len(points)), *CELLS))
        self.raster = Raster.covering(np.array(around), extent / cells)
        self.grid = _smoothed(*_interpolated(points, self.raster))

    def height(self, raster: Raster) -> NDArray[np.float32]:
        """Return (rows, columns) heights at the centres of a window's cells; NaN beyond the surface's own window."""
        at, border = self.raster.under(raster), cv2.BORDER_CONSTANT
        return np.asarray(cv2.remap(self.grid, *at, cv2.INTER_LINEAR, borderMode=border, borderValue=float("nan")))


def without_outliers(points: Array) -> Array:
    """Return those of (P, 3) points whose height is like that of their neighbours in the plane."""
    if len(points) <= NEIGHBOURS:
        return points
    near = cKDTree(points[:, :2]).query(points[:, :2], NEIGHBOURS + 1)[1]
    apart = np.abs(points[:, 2] - np.median(points[near[:, 1:], 2], axis=1))
    spread = NORMAL_MAD * np.median(np.abs(points[near, 2] - np.median(points[near, 2], axis=1)[:, None]), axis=1)
    typical = float(np.median(spread))
    return np.asarray(points[apart <= OUTLIER * np.maximum(spread, typical)])


def _interpolated(points: Array, raster: Raster) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Return (rows, columns) heights, and where they are extrapolated."""
    x, y = np.meshgrid(raster.x, raster.y)
    middle = points[:, :2].mean(axis=0)  # triangulation loses digits far from the origin
    height = LinearNDInterpolator(points[:, :2] - middle, points[:, 2])(x - middle[0], y - middle[1])
    beyond = ~np.isfinite(height)
    nearest = NearestNDInterpolator(np.column_stack([x[~beyond], y[~beyond]]), height[~beyond])
    height[beyond] = nearest(x[beyond], y[beyond])
    return np.asarray(height, np.float32), beyond


def _smoothed(height: NDArray[np.float32], beyond: NDArray[np.bool_]) -> NDArray[np.float32]:
    inside = cv2.GaussianBlur(cv2.medianBlur(height, 3), (0, 0), SMOOTH_CELLS)
    wide = cv2.GaussianBlur(inside, (0, 0), SMOOTH_BEYOND_CELLS)
    share = np.minimum(
        cv2.distanceTransform(beyond.astype(np.uint8), cv2.DIST_L2, 5) / (2.0 * SMOOTH_BEYOND_CELLS), 1.0
    )
    return np.asarray(inside + (wide - inside) * share, np.float32)
