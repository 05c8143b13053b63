# SPDX-License-Identifier: Apache-2.0
"""Detection and description of new keypoints to track, in a second thread.

Keypoints of one image join the tracks at the next image, which waits for the thread if necessary: the result does not
depend on the machine's speed.
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

MIN_DISTANCE_PX = 10.0  # of a new keypoint from tracked ones, at full resolution


class Refill:
    """Detects keypoints, in one image at a time."""

    def __init__(self, config: FrontendConfig) -> None:
        """Prepare the extractor.

        Raises:
            ConfigError: it is unknown.
        """
        self._scale = config.search_scale
        self._extractor = make_extractor(config)
        self._thread = ThreadPoolExecutor(1, "refill")
        self._search: Future[Keypoints] | None = None

    def start(self, image: NDArray[np.generic]) -> None:
        """Start detection in an (H, W) or (H, W, 3) image."""
        self._search = self._thread.submit(self._detect, image)

    def result(self) -> Keypoints | None:
        """Wait for the last detection and return its keypoints at full resolution; None if none was started."""
        if self._search is None:
            return None
        search, self._search = self._search, None
        return search.result()

    def _detect(self, image: NDArray[np.generic]) -> Keypoints:
        small = shrink(image, self._scale)
        found = self._extractor.detect(small)
        pixels = to_full_resolution(found.pixels, small.shape, image.shape)
        return Keypoints(pixels.astype(np.float32), found.responses, found.descriptors)


def choose_new(found: Keypoints, tracked: Array, count: int, shape: tuple[int, ...]) -> NDArray[np.intp]:
    """Select new keypoints to track: away from existing tracks, spread over the image.

    Args:
        found: keypoints of an image, strongest first.
        tracked: (N, 2) points tracked already [px].
        count: number wanted.
        shape: (height, width) of the image [px].

    Returns:
        (M,) rows of `found`, M <= count.
    """
    if count <= 0 or len(found) == 0:
        return np.zeros(0, np.intp)
    _, first = np.unique(found.pixels, axis=0, return_index=True)  # one point may have two orientations
    rows = np.sort(first)
    rows = rows[inside(found.pixels[rows], shape)]
    if len(tracked):
        distance, _ = cKDTree(tracked).query(found.pixels[rows])
        rows = rows[distance >= MIN_DISTANCE_PX]
    return rows[spread(found.pixels[rows], count, size=(shape[1], shape[0]), taken=tracked)]
