# SPDX-License-Identifier: Apache-2.0
"""Base of the front ends: one stereo gate for the matches and health monitoring of images and rig."""

from abc import ABC, abstractmethod

from uav_vslam.config import FrontendConfig, RigConfig
from uav_vslam.errors import InvalidMessage
from uav_vslam.geometry.stereo import StereoRig
from uav_vslam.types import StereoFeatures, StereoFrame
from uav_vslam.vision.health import FrontendHealth
from uav_vslam.vision.stereo_gate import StereoGate


class Frontend(ABC):
    """Turns the image pairs of one vehicle into stereo features, in stamp order."""

    def __init__(self, rig: StereoRig, config: FrontendConfig, rig_config: RigConfig | None, noise_px: float) -> None:
        """Prepare for one rig.

        Args:
            rig: calibration.
            config: of the front end.
            rig_config: uncertainty of the calibration; None for a rigid rig.
            noise_px: largest difference of two disparities on one surface due to noise [px].
        """
        self._rig, self._config = rig, config
        self._gate = StereoGate(rig, config, rig_config or RigConfig(), noise_px=noise_px)
        self._health = FrontendHealth(rig, self._gate.epipolar_px, (config.min_depth_m, config.max_depth_m))

    def configure(self, config: FrontendConfig) -> None:
        """Go on with live settings that have changed."""
        self._config = config
        self._gate.configure(config)
        self._health.epipolar_px = self._gate.epipolar_px
        self._health.depth_range_m = config.min_depth_m, config.max_depth_m

    @property
    def alarms(self) -> dict[str, str]:
        """Current faults of the images or the rig, by subject; normally empty."""
        return self._health.alarms

    @abstractmethod
    def process(self, frame: StereoFrame) -> StereoFeatures:
        """Return the stereo features of a pair; none if the images have no texture or are faulty.

        Raises:
            InvalidMessage: an image has another size than the calibration, or a type that can't be used.
        """

    def _check_sizes(self, frame: StereoFrame) -> None:
        """Reject images of another size than the calibration's, and empty ones, which could not be decoded."""
        for name, image, camera in (("left", frame.left, self._rig.left), ("right", frame.right, self._rig.right)):
            if image.size == 0:
                raise InvalidMessage("image", f"the {name} image could not be read")
            if image.shape[:2] != (camera.height, camera.width):
                raise InvalidMessage(
                    "image_size",
                    f"the {name} image is {image.shape[1]}x{image.shape[0]} px, but its calibration is for "
                    f"{camera.width}x{camera.height} px: calibrate at that size, or give K for it; binning and region "
                    "of interest of a camera_info are applied to K, which is that of the whole sensor",
                )
