# SPDX-License-Identifier: Apache-2.0
"""Front ends by name: image pairs in, matched points out."""

from collections.abc import Callable
from typing import Protocol

from uav_vslam.config import FrontendConfig, RigConfig
from uav_vslam.geometry.stereo import StereoRig
from uav_vslam.types import StereoFeatures, StereoFrame
from uav_vslam.vision.stereo_points import StereoFrontend
from uav_vslam.vision.tracking.frontend import TrackingFrontend


class Frontend(Protocol):
    """Turns the image pairs of one vehicle into matched points, in the order of their stamps."""

    @property
    def alarms(self) -> dict[str, str]:
        """What is wrong with the images or the rig at present, by subject; empty as a rule."""
        ...

    def process(self, frame: StereoFrame) -> StereoFeatures:
        """Return the matched points of a pair; none where the images hold no texture or can't be believed.

        Raises:
            InvalidMessage: an image has another size than the calibration, or a type that can't be used.
        """
        ...


FRONTENDS: dict[str, Callable[[StereoRig, FrontendConfig, RigConfig], Frontend]] = {
    "klt": TrackingFrontend,
    "sift": StereoFrontend,
}


def make_frontend(rig: StereoRig, config: FrontendConfig, rig_config: RigConfig) -> Frontend:
    """Build the front end that the configuration names.

    Raises:
        ConfigError: the extractor is not known.
    """
    return FRONTENDS[config.method](rig, config, rig_config)
