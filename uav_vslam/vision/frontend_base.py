# SPDX-License-Identifier: Apache-2.0
"""What every front end is: it judges its matches by one gate and watches over the images of one rig."""

from abc import ABC, abstractmethod

from uav_vslam.config import FrontendConfig, RigConfig
from uav_vslam.errors import InvalidMessage
from uav_vslam.geometry.stereo import StereoRig
from uav_vslam.types import StereoFeatures, StereoFrame
from uav_vslam.vision.health import FrontendHealth
from uav_vslam.vision.stereo_gate import StereoGate


class Frontend(ABC):
    """Turns the image pairs of one vehicle into matched points, in the order of their stamps."""

    def __init__(self, rig: StereoRig, config: FrontendConfig, rig_config: RigConfig | None, noise_px: float) -> None:
        """Prepare for one rig.

        Args:
            rig: calibration.
            config: of the front end.
            rig_config: how far the calibration is trusted; a rig that does not flex if None.
            noise_px: largest difference of two disparities of one surface that noise explains [px].
        """
        self._rig, self._config = rig, config
        self._gate = StereoGate(rig, config, rig_config or RigConfig(), noise_px=noise_px)
        self._health = FrontendHealth(rig, self._gate.epipolar_px)

    @property
    def alarms(self) -> dict[str, str]:
        """What is wrong with the images or the rig at present, by subject; empty as a rule."""
        return self._health.alarms

    @abstractmethod
    def process(self, frame: StereoFrame) -> StereoFeatures:
        """Return the matched points of a pair; none where the images hold no texture or can't be believed.

        Raises:
            InvalidMessage: an image has another size than the calibration, or a type that can't be used.
        """

    def _check_sizes(self, frame: StereoFrame) -> None:
        """Refuse images of another size than the calibration's, or of none: they could not be read."""
        for name, image, camera in (("left", frame.left, self._rig.left), ("right", frame.right, self._rig.right)):
            if image.size == 0:
                raise InvalidMessage("image", f"the {name} image could not be read")
            if image.shape[:2] != (camera.height, camera.width):
                met, wanted = image.shape[1::-1], (camera.width, camera.height)
                raise InvalidMessage("image_size", f"{name} image is {met} px but its calibration is for {wanted} px")
