# SPDX-License-Identifier: Apache-2.0
"""OpenCV's stitcher for flat scenes (SCANS: affine motion, gain blocks, graph-cut seams, multi-band blending).

It runs in a process of its own with limits, for where its affine motions diverge its pictures take all memory.
"""

import resource
from collections.abc import Sequence
from concurrent.futures.process import BrokenProcessPool

import cv2
import numpy as np
from numpy.typing import NDArray

from uav_vslam.config import FrontendConfig
from uav_vslam.mapping.view import Image
from uav_vslam.processes import worker_pool
from uav_vslam.vision.features.sift import SiftExtractor
from uav_vslam.vision.matching.ransac import ransac_homography

Array = NDArray[np.float64]

SCALE = 0.5  # of the images that it is given
FEATURES = 4000
FEATURES_OF_PICTURE = 20000
RATIO = 0.8
LARGEST_BYTES = 6 * 2**30
LONGEST_S = 300  # of processor time


def stitched(images: Sequence[Image]) -> tuple[Image, Array] | None:
    """Return the stitcher's picture and the (3, 3) affinity from the first image's pixels to it; None if it fails."""
    with worker_pool(1, _limit) as pool:
        try:
            return pool.submit(_stitched, list(images)).result()
        except (BrokenProcessPool, cv2.error, MemoryError):
            return None


def _limit() -> None:
    resource.setrlimit(resource.RLIMIT_AS, (LARGEST_BYTES, LARGEST_BYTES))
    resource.setrlimit(resource.RLIMIT_CPU, (LONGEST_S, LONGEST_S))
    cv2.setNumThreads(1)


def _stitched(images: Sequence[Image]) -> tuple[Image, Array] | None:
    small = [cv2.resize(image, None, fx=SCALE, fy=SCALE, interpolation=cv2.INTER_AREA) for image in images]
    stitcher = cv2.Stitcher.create(cv2.Stitcher_SCANS)
    stitcher.setPanoConfidenceThresh(0.3)
    status, picture = stitcher.stitch([cv2.cvtColor(image, cv2.COLOR_GRAY2BGR) for image in small])
    if status != cv2.Stitcher_OK:
        return None
    grey = cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY)
    first = SiftExtractor(FrontendConfig(max_features=FEATURES)).detect(images[0])
    whole = SiftExtractor(FrontendConfig(max_features=FEATURES_OF_PICTURE)).detect(grey)
    pairs = ransac_homography(first, whole, RATIO)
    if len(pairs) < 3:
        return None
    affinity, _ = cv2.estimateAffine2D(first.pixels[pairs[:, 0]], whole.pixels[pairs[:, 1]])
    return grey, np.vstack([affinity, [0.0, 0.0, 1.0]])
