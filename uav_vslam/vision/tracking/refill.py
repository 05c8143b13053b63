# SPDX-License-Identifier: Apache-2.0
"""New points to follow, found and described in a second thread while the images go on.

What is found in one image joins the tracks when the next one comes, waiting for the thread if it must: so the result
does not depend on how fast the machine is.
"""

from concurrent.futures import Future, ThreadPoolExecutor

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from uav_vslam.config import FrontendConfig
from uav_vslam.geometry.image_grid import spread
from uav_vslam.vision.features import Keypoints, make_extractor
from uav_vslam.vision.images import shrink, to_full_resolution
from uav_vslam.vision.tracking.flow import inside

Array = NDArray[np.float64]

MIN_DISTANCE_PX = 10.0  # of a new point from those that are followed, at full resolution


class Refill:
    """Searches images for points, one image at a time."""

    def __init__(self, config: FrontendConfig) -> None:
        """Prepare the extractor.

        Raises:
            ConfigError: it is not known.
        """
        self._scale = config.search_scale
        self._extractor = make_extractor(config)
        self._thread = ThreadPoolExecutor(1, "refill")
        self._search: Future[Keypoints] | None = None

    def begin(self, image: NDArray[np.generic]) -> None:
        """Begin to search an (H, W) or (H, W, 3) image."""
        self._search = self._thread.submit(self._detect, image)

    def result(self) -> Keypoints | None:
        """Wait for what was begun last and return its points at full resolution; None where nothing was begun."""
        if self._search is None:
            return None
        search, self._search = self._search, None
        return search.result()

    def _detect(self, image: NDArray[np.generic]) -> Keypoints:
        small = shrink(image, self._scale)
        found = self._extractor.detect(small)
        pixels = to_full_resolution(found.pixels, small.shape, image.shape)
        return Keypoints(pixels.astype(np.float32), found.responses, found.descriptors)


def choose_new(found: Keypoints, followed: Array, count: int, shape: tuple[int, ...]) -> NDArray[np.intp]:
    """Choose points to follow from now on: not where one is followed already, spread over the image.

    Args:
        found: points of an image, strongest first.
        followed: (N, 2) points that are followed already [px].
        count: how many are wanted.
        shape: (height, width) of the image [px].

    Returns:
        (M,) rows of `found`, M <= count.
    """
    if count <= 0 or len(found) == 0:
        return np.zeros(0, np.intp)
    _, first = np.unique(found.pixels, axis=0, return_index=True)  # two orientations of one point are one point
    rows = np.sort(first)
    rows = rows[inside(found.pixels[rows], shape)]
    if len(followed):
        distance, _ = cKDTree(followed).query(found.pixels[rows])
        rows = rows[distance >= MIN_DISTANCE_PX]
    return rows[spread(found.pixels[rows], count, size=(shape[1], shape[0]), taken=followed)]
