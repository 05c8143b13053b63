# SPDX-License-Identifier: Apache-2.0
"""The views of a recorded or simulated flight: its left images, undistorted, each with its pose."""

from collections.abc import Iterable, Iterator, Mapping

import numpy as np
from numpy.typing import NDArray

from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.stereo import StereoRig
from uav_vslam.mapping.undistortion import Undistorter
from uav_vslam.mapping.view import View
from uav_vslam.vision.images import to_bgr8, to_grey8


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
        InvalidMessage: an image has another shape or type.
    """
    lens = Undistorter(rig.left)
    for stamp_ns, pixels in images:
        if stamp_ns in poses:
            image = to_bgr8(pixels) if pixels.ndim == 3 and pixels.shape[2] == 3 else to_grey8(pixels)
            yield View(vehicle, stamp_ns, lens.camera, poses[stamp_ns] @ rig.T_body_left, lens.apply(image))
