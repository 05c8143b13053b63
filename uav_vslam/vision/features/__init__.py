# SPDX-License-Identifier: Apache-2.0
"""Feature extractors by name; each is built from the front end's configuration."""

from collections.abc import Callable
from functools import partial

from uav_vslam.config import FrontendConfig
from uav_vslam.vision.features.asift import AffineSiftExtractor
from uav_vslam.vision.features.base import Extractor, Keypoints, detect_chosen
from uav_vslam.vision.features.dense import DenseSiftExtractor
from uav_vslam.vision.features.orb import OrbExtractor
from uav_vslam.vision.features.phow import COLOURS, PhowExtractor
from uav_vslam.vision.features.sift import SiftExtractor
from uav_vslam.vision.features.surf import SurfExtractor

__all__ = ["EXTRACTORS", "Extractor", "Keypoints", "detect_chosen", "make_extractor"]

EXTRACTORS: dict[str, Callable[[FrontendConfig], Extractor]] = {
    "sift": SiftExtractor,
    "asift": AffineSiftExtractor,
    "surf": SurfExtractor,
    "dsift": DenseSiftExtractor,
    **{f"phow_{colour}": partial(PhowExtractor, colour=colour) for colour in COLOURS},
    "orb": OrbExtractor,
}


def make_extractor(config: FrontendConfig) -> Extractor:
    """Build the configured extractor.

    Raises:
        ConfigError: a required package is not installed.
    """
    return EXTRACTORS[config.extractor](config)
