# SPDX-License-Identifier: Apache-2.0
"""Do the images fit the calibration?"""

from uav_vslam.errors import InvalidMessage
from uav_vslam.geometry.stereo import StereoRig
from uav_vslam.types import StereoFrame


def check_sizes(frame: StereoFrame, rig: StereoRig) -> None:
    """Refuse images of another size than the calibration's.

    Raises:
        InvalidMessage: they are.
    """
    for name, image, camera in (("left", frame.left, rig.left), ("right", frame.right, rig.right)):
        if image.shape[:2] != (camera.height, camera.width):
            met, wanted = image.shape[1::-1], (camera.width, camera.height)
            raise InvalidMessage("image_size", f"{name} image is {met} px but its calibration is for {wanted} px")
