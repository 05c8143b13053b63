# SPDX-License-Identifier: Apache-2.0
"""The views of a recorded or simulated flight: its left images, undistorted, each with its pose."""

from collections.abc import Iterable, Iterator, Mapping

import numpy as np
from numpy.typing import NDArray

from uav_vslam.errors import InvalidMessage
from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.stereo import StereoRig
from uav_vslam.mapping.undistortion import Undistorter
from uav_vslam.mapping.view import View
from uav_vslam.vision.images import to_bgr8, to_grey8


class LeftCamera:
    """Makes views of one vehicle's left images."""

    def __init__(self, vehicle: str, rig: StereoRig) -> None:
        self._vehicle, self._T_body_left = vehicle, rig.T_body_left
        self._lens = Undistorter(rig.left)

    def view(self, stamp_ns: int, pixels: NDArray[np.generic], T_map_body: Pose) -> View:
        """Return an image, grey or BGR, with its pose as a view.

        Raises:
            InvalidMessage: the image has another size than the calibration, or a type that can't be used.
        """
        met, wanted = pixels.shape[1::-1], self._lens.camera.size
        if met != wanted:  # undistortion would stretch it without a word
            raise InvalidMessage("image_size", f"left image is {met} px but its calibration is for {wanted} px")
        image = to_bgr8(pixels) if pixels.ndim == 3 and pixels.shape[2] == 3 else to_grey8(pixels)
        T_map_cam = T_map_body @ self._T_body_left
        return View(self._vehicle, stamp_ns, self._lens.camera, T_map_cam, self._lens.apply(image))


def flight_views(
    vehicle: str, rig: StereoRig, poses: Mapping[int, Pose], images: Iterable[tuple[int, NDArray[np.generic]]]
) -> Iterator[View]:
    """Yield the views of one vehicle, in the order of its images.

    Args:
        vehicle: name.
        rig: its calibration.
        poses: T_map_body by stamp [ns].
        images: stamps [ns] and pixels of the left camera, grey or BGR; those without a pose are left out.

    Raises:
        InvalidMessage: an image has another size than the calibration, or a type that can't be used.
    """
    camera = LeftCamera(vehicle, rig)
    for stamp_ns, pixels in images:
        if stamp_ns in poses:
            yield camera.view(stamp_ns, pixels, poses[stamp_ns])
