# SPDX-License-Identifier: Apache-2.0
"""A view as seen from straight above: its pixels drawn onto the surface, each with a score of how well it is seen.

An array over a view of 20 megapixels is 100 MB, so a view is looked at coarsely first, and then drawn window by window.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from uav_vslam.errors import UavVslamError
from uav_vslam.mapping.orthomosaic.footprint import LARGEST_TANGENT, footprint
from uav_vslam.mapping.orthomosaic.heights import Heights
from uav_vslam.mapping.orthomosaic.visibility import visible
from uav_vslam.mapping.raster import Raster
from uav_vslam.mapping.view import Image, View

Real = NDArray[np.float32]

HALF_SCORE_TANGENT = 0.4  # of the angle from the vertical at which a spot counts half
BORDER_SHARE = 0.06  # of the image, in which the score rises from its edge
LEAST_SCORE = 0.01  # of what is seen at all
OVERSAMPLING = 1.25  # pixels of the image, made smaller first, to one of the mosaic
MOST_PX = 32_766  # along a side of a view
TILE_PX = 512  # side of what is drawn at a time
COARSE_CELL_M = 0.2  # of the look at the whole view, or less, where it has fewer cells along a side than
LEAST_CELLS = 100
FAR_OUTSIDE_PX = -1e6  # stands for a pixel that is not known
BLACK, UNCLIPPED, WHITE = 2.0, 128.0, 250.0  # grey levels of the brightest channel: clipped up to BLACK, above WHITE
CLIPPED_PX = 33  # side of the surroundings whose clipped share counts, so that single pixels do not change the view


@dataclass(frozen=True, slots=True)
class Rectified:
    """A view on the mosaic's grid.

    Attributes:
        raster: its window.
        image: (rows, columns, channels) float32 grey levels; meaningless where the score is 0.
        score: (rows, columns) float32 quality of the view, 0 where nothing is seen.
        radius2: (rows, columns) float32 squared distance from the principal point over the focal length.
    """

    raster: Raster
    image: Real
    score: Real
    radius2: Real


@dataclass(frozen=True, slots=True)
class _Sight:
    """How the cells of a window are seen, each attribute (rows, columns) float32.

    Attributes:
        u, v: pixels; `FAR_OUTSIDE_PX` where the height is not known, or behind the camera.
        depth: [m], NaN there.
        tangent2: squared tangent of the angle from the vertical; NaN above the camera, and where the height is unknown.
        radius2: squared distance from the principal point over the focal length; 0 where u and v are far outside.
    """

    u: Real
    v: Real
    depth: Real
    tangent2: Real
    radius2: Real


@dataclass(frozen=True, slots=True)
class _Look:
    """What a coarse look at a whole view shows.

    Attributes:
        raster: its cells.
        visible: (rows, columns) where nothing that stands is between the camera and the surface.
        nearest_m, usual_m: smallest and median depth of what is seen [m].
    """

    raster: Raster
    visible: NDArray[np.bool_]
    nearest_m: float
    usual_m: float

    @staticmethod
    def at(view: View, surface: Heights, raster: Raster) -> "_Look | None":
        """Return the look with these cells; None where nothing of the surface is seen."""
        heights = surface.height(raster)
        sight = _sight(view, raster, heights)
        unhidden = visible(raster, heights, view.T_map_cam.t)
        depths = sight.depth[(_score(view, sight, nearest_m=1.0) > 0) & unhidden]
        if len(depths) == 0:
            return None
        return _Look(raster, unhidden, float(depths.min()), float(np.median(depths)))

    def visible_at(self, raster: Raster) -> NDArray[np.bool_]:
        """Return (rows, columns) of a window, a whole number of whose cells make one of these each way."""
        stride = round(self.raster.cell_m / raster.cell_m)
        rows = (raster.row + np.arange(raster.rows)) // stride - self.raster.row
        columns = (raster.column + np.arange(raster.columns)) // stride - self.raster.column
        rows, columns = np.clip(rows, 0, self.raster.rows - 1), np.clip(columns, 0, self.raster.columns - 1)
        return np.asarray(self.visible[rows][:, columns])


class Drawing:
    """A view that can be drawn onto any window of the mosaic's grid.

    Attributes:
        raster: window of all that it sees.
    """

    def __init__(self, view: View, surface: Heights, raster: Raster, look: _Look, *, sharpness: float) -> None:
        """See `of`."""
        self.raster = raster
        self._view, self._surface, self._look = view, surface, look
        pixels = look.usual_m / view.camera.fx / raster.cell_m  # of the mosaic, under one of the image
        self._factor = np.float32(sharpness * min(1.0, 1.0 / pixels))  # seen from higher up: coarser than the mosaic
        self._source = view.image.astype(np.float32)
        if (scale := pixels * OVERSAMPLING) < 1.0:
            height, width = (max(1, round(side * scale)) for side in view.image.shape[:2])
            self._source = cv2.resize(self._source, (width, height), interpolation=cv2.INTER_AREA)

    @staticmethod
    def of(view: View, surface: Heights, m_per_px: float, *, sharpness: float = 1.0) -> "Drawing | None":
        """Look at the whole view; None where it sees nothing of the surface.

        Args:
            view: the image, its camera and pose.
            surface: heights in the map frame.
            m_per_px: side of a pixel of the mosaic [m].
            sharpness: factor of the score.

        Raises:
            UavVslamError: the pixels are too small.
        """
        raster = footprint(view.camera, view.T_map_cam, surface, m_per_px)
        if raster.columns == 0:
            return None
        if (side := max(raster.shape)) > MOST_PX:
            raise UavVslamError(
                f"in pixels of {m_per_px:g} m a view of the orthomosaic is {side} pixels long, and {MOST_PX} can be "
                f"drawn; use a --pixel of more than {m_per_px * side / MOST_PX:.2g} m"
            )
        stride = max(1, min(round(COARSE_CELL_M / m_per_px), min(raster.shape) // LEAST_CELLS))
        look = _Look.at(view, surface, raster.with_cells(stride * m_per_px))
        return None if look is None else Drawing(view, surface, raster, look, sharpness=sharpness)

    def draw(self, raster: Raster) -> Rectified:
        """Return a window; up to half of `CLIPPED_PX` from its edge, the score does not count all that is clipped."""
        channels = 1 if self._view.image.ndim == 2 else 3
        image = np.empty((*raster.shape, channels), np.float32)
        score, radius2 = (np.empty(raster.shape, np.float32) for _ in range(2))
        for tile in raster.tiles(TILE_PX):
            part = tile.intersection(raster)
            at = part.within(raster)
            image[at], score[at], radius2[at] = self._part(part)
        score *= np.maximum(1.0 - _clipped_share(image), np.float32(LEAST_SCORE))
        return Rectified(raster, image, score, radius2)

    def _part(self, raster: Raster) -> tuple[Real, Real, Real]:
        """Return image, score and squared radius of a window of which a dozen arrays are small."""
        sight = _sight(self._view, raster, self._surface.height(raster))
        score = _score(self._view, sight, nearest_m=self._look.nearest_m)
        score *= self._factor * self._look.visible_at(raster)
        image = self._image_at(sight.u, sight.v) if score.any() else np.full((1, 1, 1), UNCLIPPED, np.float32)
        return image, score, sight.radius2

    def _image_at(self, u: Real, v: Real) -> Real:
        """Return (rows, columns, channels) at pixels u, v, with what is finer than the mosaic averaged out."""
        scale_v, scale_u = (a / b for a, b in zip(self._source.shape, self._view.image.shape[:2], strict=False))
        map_u, map_v = (
            at if scale == 1.0 else (at + np.float32(0.5)) * np.float32(scale) - np.float32(0.5)
            for at, scale in ((u, scale_u), (v, scale_v))
        )
        drawn = cv2.remap(self._source, map_u, map_v, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
        return np.asarray(drawn.reshape(*u.shape, -1))


def _clipped_share(image: Real) -> Real:
    """Return the (rows, columns) share of the surroundings that are over- or underexposed, and show no detail."""
    below_white, black = (cv2.inRange(image, (-np.inf,) * 4, (most,) * 4) for most in (WHITE, BLACK))
    clipped = cv2.boxFilter(~below_white | black, cv2.CV_32F, (CLIPPED_PX, CLIPPED_PX))
    return np.asarray(clipped / np.float32(255.0))


def sharpness_of(image: Image) -> float:
    """Return the share of an image's contrast that is between neighbouring pixels: it falls with blur."""
    grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) if image.ndim == 3 else image
    half = cv2.resize(grey, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)  # noise counts less
    return float(np.std(cv2.Laplacian(half, cv2.CV_32F)) / max(float(np.std(half)), 1e-6))


def _sight(view: View, raster: Raster, heights: Real) -> _Sight:
    dx = (raster.x - view.T_map_cam.t[0]).astype(np.float32)
    dy = (raster.y - view.T_map_cam.t[1]).astype(np.float32)[:, None]
    dz = heights - np.float32(view.T_map_cam.t[2])
    x, y, z = (
        axis[0] * dx + axis[1] * dy + axis[2] * dz for axis in view.T_map_cam.R.T.astype(np.float32)
    )  # axes of the camera in the map
    z[~(z > 0)] = np.nan
    x /= z
    y /= z
    with np.errstate(divide="ignore", invalid="ignore"):
        tangent2 = (dx * dx + dy * dy) / (dz * dz)
    tangent2[~(dz < 0)] = np.nan
    camera = view.camera
    u, v = np.float32(camera.fx) * x + np.float32(camera.cx), np.float32(camera.fy) * y + np.float32(camera.cy)
    radius2 = x * x + y * y
    for pixels, unknown in ((u, FAR_OUTSIDE_PX), (v, FAR_OUTSIDE_PX), (radius2, 0.0)):
        cv2.patchNaNs(pixels, unknown)
    return _Sight(u, v, z, tangent2, radius2)


def _score(view: View, sight: _Sight, *, nearest_m: float) -> Real:
    """Return (rows, columns) scores in [0, 1]: best straight below, low at the image's edge, 0 outside."""
    camera, u, v, tangent2 = view.camera, sight.u, sight.v, sight.tangent2
    edge_u = np.minimum(u, camera.width - 1 - u) / np.float32(BORDER_SHARE * camera.width)
    edge_v = np.minimum(v, camera.height - 1 - v) / np.float32(BORDER_SHARE * camera.height)
    edge = np.minimum(np.minimum(edge_u, edge_v), np.float32(1.0))
    with np.errstate(invalid="ignore", divide="ignore"):
        inside = (edge >= 0) & (tangent2 <= LARGEST_TANGENT**2)
        score = edge * (np.float32(nearest_m) / sight.depth) / (1.0 + tangent2 / np.float32(HALF_SCORE_TANGENT**2))
    score = np.where(inside, np.maximum(score, np.float32(LEAST_SCORE)), np.float32(0.0))
    if view.opaque is not None:
        score *= cv2.remap(view.opaque.astype(np.float32), u, v, cv2.INTER_NEAREST)
    return score
