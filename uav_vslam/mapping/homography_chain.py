# SPDX-License-Identifier: Apache-2.0
"""The thesis's mosaic, section 5.5 of [thesis], as a baseline: neighbouring images joined by homographies.

SIFT points of consecutive images are matched, RANSAC finds the homography between the two, and the product of all maps
each image onto the first one. Errors accumulate along the chain, and ground that is not a plane does not fit. Later
images cover earlier ones, without blending.
"""

from collections.abc import Iterable, Sequence
from itertools import count

import cv2
import numpy as np
from numpy.typing import NDArray

from uav_vslam.config import FrontendConfig
from uav_vslam.errors import UavVslamError
from uav_vslam.mapping.opacity import within, without_alpha
from uav_vslam.mapping.orthomosaic.mosaic import UNSEEN, Picture
from uav_vslam.mapping.raster import Raster
from uav_vslam.mapping.view import Image
from uav_vslam.vision.features.base import Keypoints
from uav_vslam.vision.features.sift import SiftExtractor
from uav_vslam.vision.matching.ransac import ransac_homography

Array = NDArray[np.float64]

FEATURES = 2000
RATIO = 0.8
LEAST_MATCHES = 12
LARGEST_PX = 2e8


def chain_homographies(images: Iterable[Image], names: Sequence[str] = ()) -> list[Array]:
    """Return (3, 3) homographies from the pixels of each image to those of the first.

    Args:
        images: in order; (H, W) grey, (H, W, 3) BGR or (H, W, 4) BGRA, of which the opaque part counts.
        names: how errors call them; by number if there are none.

    Raises:
        UavVslamError: two consecutive images have too little in common.
    """
    extractor = SiftExtractor(FrontendConfig(max_features=FEATURES))
    found: list[Array] = []
    before: tuple[Keypoints, str | int] | None = None
    labels: Iterable[str | int] = names or count()
    for name, image in zip(labels, images, strict=False):
        shown, opaque = without_alpha(image)
        points = within(extractor.detect(shown), opaque)
        found.append(found[-1] @ _between(points, name, *before) if before is not None else np.eye(3))
        before = points, name
    return found


def chained_mosaic(images: Iterable[Image], to_map: list[Array], m_per_px: float) -> Picture:
    """Draw images on a plane, later ones over earlier ones.

    Args:
        images: as many as there are homographies, all of one size; as above.
        to_map: (3, 3) homographies from pixels to x, y of the map [m].
        m_per_px: side of a pixel of the mosaic [m].

    Raises:
        UavVslamError: the chain has come apart, an image reaches the horizon or is stretched beyond all measure.
    """
    raster, picture, labels = Raster(m_per_px, 0, 0, 0, 0), np.zeros((0, 0), np.uint8), np.zeros((0, 0), np.int32)
    for number, (given, H) in enumerate(zip(images, to_map, strict=True)):
        image, opaque = without_alpha(given)
        if number == 0:
            raster = _window(to_map, image, m_per_px)
            picture = np.zeros((*raster.shape, *image.shape[2:]), np.uint8)
            labels = np.full(raster.shape, UNSEEN, np.int32)
        part = _window([H], image, m_per_px).intersection(raster)
        west, south, _, _ = part.bounds_m
        place = np.array([[1 / m_per_px, 0.0, -west / m_per_px - 0.5], [0.0, 1 / m_per_px, -south / m_per_px - 0.5]])
        warp = np.vstack([place, [0.0, 0.0, 1.0]]) @ H
        drawn = cv2.warpPerspective(image, warp, part.shape[::-1], flags=cv2.INTER_LINEAR)
        inside = np.ones(image.shape[:2], np.uint8) if opaque is None else opaque.astype(np.uint8)
        seen = cv2.warpPerspective(inside, warp, part.shape[::-1], flags=cv2.INTER_NEAREST) > 0
        at = part.within(raster)
        picture[at][seen], labels[at][seen] = drawn[seen], number
    return Picture(raster, picture, labels)


def _between(points: Keypoints, name: str | int, before: Keypoints, name_before: str | int) -> Array:
    """Return the homography from an image to the one before."""
    pairs = ransac_homography(points, before, RATIO)
    if len(pairs) < LEAST_MATCHES:
        raise UavVslamError(
            f"images {name_before} and {name} have {len(pairs)} points in common, a chain of homographies needs "
            f"{LEAST_MATCHES}; take images that overlap more"
        )
    H, _ = cv2.findHomography(points.pixels[pairs[:, 0]], before.pixels[pairs[:, 1]], 0)
    return np.asarray(H)


def _window(to_map: list[Array], image: Image, m_per_px: float) -> Raster:
    rows, columns = image.shape[:2]
    corners = np.array([[0, 0, 1], [columns - 1, 0, 1], [columns - 1, rows - 1, 1], [0, rows - 1, 1]], float)
    places = np.stack([corners @ H.T for H in to_map])
    depth = places[..., 2]
    if not (depth[:, :1] * depth > 0).all():
        raise UavVslamError("the chain of homographies has come apart: an image reaches the horizon; use fewer images")
    window = Raster.covering((places[..., :2] / depth[..., None]).reshape(-1, 2), m_per_px)
    if window.columns * window.rows > LARGEST_PX:
        raise UavVslamError(
            f"the chain of homographies has come apart: its mosaic would have {window.columns} x {window.rows} pixels, "
            f"more than {LARGEST_PX:.0e}; use fewer images or larger pixels"
        )
    return window
