# SPDX-License-Identifier: Apache-2.0
"""Keypoints of images that many tests search again, and what pairs of them show."""

import pickle
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import numpy as np
import pytest
from numpy.typing import NDArray

from uav_vslam.config import FrontendConfig
from uav_vslam.geometry.stereo import StereoRig
from uav_vslam.inspection import views
from uav_vslam.types import StereoFrame
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


@contextmanager
def remembered_looks() -> Iterator[None]:
    """Judge the same sampled pairs with the same rig once; nobody may change what they show."""
    look = views.look
    known: dict[bytes, views.Views] = {}

    def remembered(
        samples: Sequence[tuple[StereoFrame, StereoFrame | None]], rig: StereoRig, config: FrontendConfig
    ) -> views.Views:
        key = pickle.dumps((samples, rig, config))
        if key not in known:
            known[key] = look(samples, rig, config)
            known[key].pixels.flags.writeable = False
        return known[key]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(views, "look", remembered)
        yield
