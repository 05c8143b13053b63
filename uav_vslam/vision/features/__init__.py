# SPDX-License-Identifier: Apache-2.0
"""Feature extractors by name; each is built from the front end's configuration."""

from collections.abc import Callable

from uav_vslam.config import FrontendConfig
from uav_vslam.errors import ConfigError
from uav_vslam.vision.features.base import Extractor, Keypoints
from uav_vslam.vision.features.sift import SiftExtractor

__all__ = ["EXTRACTORS", "Extractor", "Keypoints", "make_extractor"]

EXTRACTORS: dict[str, Callable[[FrontendConfig], Extractor]] = {"sift": SiftExtractor}


def make_extractor(config: FrontendConfig) -> Extractor:
    """Build the extractor that the configuration names.

    Raises:
        ConfigError: no extractor has that name.
    """
    if config.extractor not in EXTRACTORS:
        raise ConfigError(f"frontend.extractor = {config.extractor!r} is not known; use one of {', '.join(EXTRACTORS)}")
    return EXTRACTORS[config.extractor](config)
