# SPDX-License-Identifier: Apache-2.0
"""Front ends by name: image pairs in, stereo features out."""

from collections.abc import Callable

from uav_vslam.config import FrontendConfig, RigConfig
from uav_vslam.geometry.stereo import StereoRig
from uav_vslam.vision.frontend_base import Frontend
from uav_vslam.vision.stereo_points import StereoFrontend
from uav_vslam.vision.tracking.frontend import TrackingFrontend

FRONTENDS: dict[str, Callable[[StereoRig, FrontendConfig, RigConfig], Frontend]] = {
    "klt": TrackingFrontend,
    "sift": StereoFrontend,
}


def make_frontend(rig: StereoRig, config: FrontendConfig, rig_config: RigConfig) -> Frontend:
    """Build the configured front end.

    Raises:
        ConfigError: a package required by the extractor is not installed.
    """
    return FRONTENDS[config.method](rig, config, rig_config)
