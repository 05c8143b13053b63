# SPDX-License-Identifier: Apache-2.0
"""Keypoints of images that many tests search again."""

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import pytest
from numpy.typing import NDArray

from uav_vslam.vision.features.base import Keypoints
from uav_vslam.vision.features.sift import SiftExtractor


@contextmanager
def remembered_sift() -> Iterator[None]:
    """Search each image once with each setting; the same bytes have the same keypoints, which nobody may change."""
    detect = SiftExtractor.detect
    known: dict[tuple[object, ...], Keypoints] = {}

    def remembered(extractor: SiftExtractor, image: NDArray[np.generic]) -> Keypoints:
        sift = extractor._sift
        key = (sift.getNFeatures(), sift.getContrastThreshold(), image.dtype, image.shape, image.tobytes())
        if key not in known:
            known[key] = detect(extractor, image)
            for array in (known[key].pixels, known[key].responses, known[key].descriptors):
                array.flags.writeable = False
        return known[key]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(SiftExtractor, "detect", remembered)
        yield
