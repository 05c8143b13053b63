# SPDX-License-Identifier: Apache-2.0
"""A map and a frame that shows part of it, with a common prediction error."""

from collections.abc import Callable

import numpy as np
import pytest

from uav_vslam.association import InView
from uav_vslam.association.descriptor_statistics import DescriptorStatistics
from uav_vslam.types import StereoFeatures

Scene = Callable[..., tuple[InView, StereoFeatures]]
SIZE_PX = (1200.0, 900.0)


@pytest.fixture
def scene() -> Scene:
    """Return a function for N landmarks and N features; feature k shows landmark k."""

    def make(count: int, *, seed: int = 1, off_px: float = 5.0, noise: float = 6.0) -> tuple[InView, StereoFeatures]:
        rng = np.random.default_rng(seed)
        left = rng.uniform(0.0, SIZE_PX, (count, 2))
        pixels = np.hstack([left, left - [20.0, 0.0]])
        descriptors = rng.integers(40, 216, (count, 128)).astype(np.uint8)
        seen = np.clip(descriptors + rng.normal(0.0, noise, descriptors.shape), 0, 255).astype(np.uint8)
        S = np.tile(30.0 * np.eye(4), (count, 1, 1))
        in_view = InView(3 * np.arange(count), pixels + off_px, S, descriptors, DescriptorStatistics.of(descriptors))
        return in_view, StereoFeatures(0, (pixels + rng.normal(0, 0.5, pixels.shape)).astype(np.float32), seen)

    return make
