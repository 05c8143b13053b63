# SPDX-License-Identifier: Apache-2.0
"""Detection, selection and description of new keypoints to track, in a second thread.

Keypoints of one image join the tracks at the next image, which waits for the thread if necessary: the result does not
depend on the machine's speed.
"""

from concurrent.futures import Future, ThreadPoolExecutor

import numpy as np
from numpy.typing import NDArray

from uav_vslam.config import FrontendConfig
from uav_vslam.geometry.image_grid import spread
from uav_vslam.vision.features import Keypoints, detect_chosen, make_extractor
from uav_vslam.vision.images import shrink, to_full_resolution
from uav_vslam.vision.nearest_points import nearest_points
from uav_vslam.vision.tracking.flow import inside
from uav_vslam.vision.tracking.search_area import search_area, whole

Array = NDArray[np.float64]

MIN_DISTANCE_PX = 10.0  # of a new keypoint from tracked ones, at full resolution


class Refill:
    """Detects keypoints, in one image at a time."""

    def __init__(self, config: FrontendConfig) -> None:
        """Prepare the extractor.

        Raises:
            ConfigError: it is not installed.
        """
        self._scale = config.search_scale
        self._extractor = make_extractor(config)
        self._thread = ThreadPoolExecutor(1, "refill")
        self._search: Future[Keypoints] | None = None
        self._wanted = 0
        self._everywhere = False  # the last search did not find enough

    def start(self, image: NDArray[np.generic], tracked: Array, count: int) -> None:
        """Start detection.

        Args:
            image: (H, W) or (H, W, 3).
            tracked: (N, 2) points tracked already [px].
            count: number of new ones wanted, at least 1.
        """
        area = whole(image.shape) if self._everywhere else search_area(tracked, count, image.shape)
        self._search = self._thread.submit(self._detect, image, area, tracked, count)
        self._wanted = count

    def result(self) -> Keypoints | None:
        """Wait for the last detection and return the keypoints to track, at full resolution; None if not started."""
        if self._search is None:
            return None
        search, self._search = self._search, None
        found = search.result()
        self._everywhere = len(found) < self._wanted
        return found

    def _detect(self, image: NDArray[np.generic], area: tuple[slice, slice], tracked: Array, count: int) -> Keypoints:
        part = image[area]
        small = shrink(part, self._scale)
        origin = area[1].start, area[0].start

        def full(pixels: NDArray[np.float32]) -> NDArray[np.float32]:
            return (to_full_resolution(pixels, small.shape, part.shape) + origin).astype(np.float32)

        found = detect_chosen(
            self._extractor, small, lambda pixels: choose_new(full(pixels), tracked, count, image.shape)
        )
        return Keypoints(full(found.pixels), found.responses, found.descriptors)


def choose_new(pixels: NDArray[np.float32], tracked: Array, count: int, shape: tuple[int, ...]) -> NDArray[np.intp]:
    """Select new keypoints to track: away from existing tracks, spread over the image.

    Args:
        pixels: (K, 2) keypoints of an image, strongest first [px].
        tracked: (N, 2) points tracked already [px].
        count: number wanted, at least 1.
        shape: (height, width) of the image [px].

    Returns:
        (M,) rows of `pixels`, M <= count.
    """
    _, first = np.unique(pixels, axis=0, return_index=True)  # one point may have two orientations
    rows = np.sort(first)
    rows = rows[inside(pixels[rows], shape)]
    if len(tracked):
        distance, _ = nearest_points(pixels[rows], tracked, 1)
        rows = rows[distance[:, 0] >= MIN_DISTANCE_PX]
    return rows[spread(pixels[rows], count, size=(shape[1], shape[0]), taken=tracked)]
