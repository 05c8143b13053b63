# SPDX-License-Identifier: Apache-2.0
"""A view as seen from straight above: its pixels drawn onto the surface, each with a score of how well it is seen."""

import functools
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from uav_vslam.errors import UavVslamError
from uav_vslam.geometry.camera import PinholeCamera
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
BLACK, WHITE = 2.0, 250.0  # grey levels of the brightest channel beyond which an image is clipped
MOST_PX = 32_766  # along a side of what OpenCV draws at once
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


def rectify(
    view: View, surface: Heights, m_per_px: float, *, sharpness: float = 1.0, align: int = 1, margin: int = 0
) -> Rectified | None:
    """Draw a view onto the surface; None where it sees nothing of it.

    Args:
        view: the image, its camera and pose.
        surface: heights in the map frame.
        m_per_px: side of a pixel of the mosaic [m].
        sharpness: factor of the score.
        align: the window's edges are multiples of this many pixels.
        margin: pixels around the footprint.

    Raises:
        UavVslamError: the pixels are too small to draw the view at once.
    """
    raster = footprint(view.camera, view.T_map_cam, surface, m_per_px)
    if raster.columns == 0:
        return None
    raster = raster.grown(margin, align=align)
    if (side := max(raster.shape)) > MOST_PX:
        raise UavVslamError(
            f"in pixels of {m_per_px:g} m a view of the orthomosaic is {side} pixels long, and {MOST_PX} can be drawn; "
            f"use a --pixel of more than {m_per_px * side / MOST_PX:.2g} m"
        )
    heights = surface.height(raster)
    u, v, depth, tangent2 = _seen_at(view, raster, heights)
    score = _score(view.camera, u, v, depth, tangent2) * np.float32(sharpness)
    score *= visible(raster, heights, view.T_map_cam.t)
    if view.opaque is not None:
        at = (np.nan_to_num(one, nan=-1.0) for one in (u, v))
        score *= cv2.remap(view.opaque.astype(np.float32), *at, cv2.INTER_NEAREST)
    if not score.any():
        return None
    ground_m_per_px = float(np.median(depth[score > 0])) / view.camera.fx
    score *= np.float32(min(1.0, m_per_px / ground_m_per_px))  # from higher up, or smaller: coarser than the mosaic
    del depth, tangent2, heights  # each is as large as a channel of the image
    image = _drawn(view.image, u, v, ground_m_per_px * OVERSAMPLING / m_per_px)
    score *= np.maximum(1.0 - _clipped_share(image), np.float32(LEAST_SCORE))
    radius2 = ((u - view.camera.cx) / view.camera.fx) ** 2 + ((v - view.camera.cy) / view.camera.fy) ** 2
    return Rectified(raster, image, score, np.nan_to_num(radius2.astype(np.float32)))


def _clipped_share(image: Real) -> Real:
    """Return the (rows, columns) share of the surroundings that are over- or underexposed, and show no detail."""
    brightest = functools.reduce(np.maximum, np.moveaxis(image, -1, 0))  # four times as fast as image.max(axis=-1)
    clipped = ((brightest >= WHITE) | (brightest <= BLACK)).astype(np.float32)
    return np.asarray(cv2.blur(clipped, (CLIPPED_PX, CLIPPED_PX)))


def sharpness_of(image: Image) -> float:
    """Return the share of an image's contrast that is between neighbouring pixels: it falls with blur."""
    grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) if image.ndim == 3 else image
    half = cv2.resize(grey, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)  # noise counts less
    return float(np.std(cv2.Laplacian(half, cv2.CV_32F)) / max(float(np.std(half)), 1e-6))


def _seen_at(view: View, raster: Raster, heights: Real) -> tuple[Real, Real, Real, Real]:
    """Return each cell's pixel u, v, depth [m] and squared tangent of the angle from the vertical; NaN if unknown."""
    dx = (raster.x - view.T_map_cam.t[0]).astype(np.float32)
    dy = (raster.y - view.T_map_cam.t[1]).astype(np.float32)[:, None]
    dz = heights - np.float32(view.T_map_cam.t[2])
    x, y, z = (
        axis[0] * dx + axis[1] * dy + axis[2] * dz for axis in view.T_map_cam.R.T.astype(np.float32)
    )  # axes of the camera in the map
    camera = view.camera
    with np.errstate(divide="ignore", invalid="ignore"):
        u = np.float32(camera.fx) * x / z + np.float32(camera.cx)
        v = np.float32(camera.fy) * y / z + np.float32(camera.cy)
        tangent2 = (dx * dx + dy * dy) / (dz * dz)
    tangent2[~((z > 0) & (dz < 0))] = np.nan
    return u, v, z, tangent2


def _score(camera: PinholeCamera, u: Real, v: Real, depth: Real, tangent2: Real) -> Real:
    """Return (rows, columns) scores in [0, 1]: best straight below, low at the image's edge, 0 outside."""
    edge_u = np.minimum(u, camera.width - 1 - u) / np.float32(BORDER_SHARE * camera.width)
    edge_v = np.minimum(v, camera.height - 1 - v) / np.float32(BORDER_SHARE * camera.height)
    edge = np.minimum(np.minimum(edge_u, edge_v), 1.0)
    with np.errstate(invalid="ignore", divide="ignore"):
        inside = (edge >= 0) & (tangent2 <= LARGEST_TANGENT**2)
        nearest = np.nanmin(np.where(inside, depth, np.inf), initial=np.inf)
        resolution = nearest / depth
        score = edge * resolution / (1.0 + tangent2 / HALF_SCORE_TANGENT**2)
    return np.where(inside, np.maximum(score, LEAST_SCORE), 0.0).astype(np.float32)


def _drawn(image: Image, u: Real, v: Real, scale: float) -> Real:
    """Return the image at (rows, columns) pixels u, v, with what is finer than the mosaic averaged out."""
    source, scale_u, scale_v = image.astype(np.float32), 1.0, 1.0
    if scale < 1.0:
        size = max(1, round(image.shape[1] * scale)), max(1, round(image.shape[0] * scale))
        scale_u, scale_v = size[0] / image.shape[1], size[1] / image.shape[0]
        source = cv2.resize(source, size, interpolation=cv2.INTER_AREA)
    map_u = (np.nan_to_num(u, nan=-1e6) + 0.5) * np.float32(scale_u) - np.float32(0.5)
    map_v = (np.nan_to_num(v, nan=-1e6) + 0.5) * np.float32(scale_v) - np.float32(0.5)
    drawn = cv2.remap(source, map_u, map_v, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(drawn.reshape(*u.shape, -1))
