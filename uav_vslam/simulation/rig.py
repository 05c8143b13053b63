# SPDX-License-Identifier: Apache-2.0
"""The stereo rig of the Kagaru aircraft, tables 7.4.1 and 7.4.2 of [thesis]: two cameras pointing straight down."""

import dataclasses

import numpy as np

from uav_vslam.geometry.camera import PinholeCamera
from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.rotation import so3_exp
from uav_vslam.geometry.stereo import StereoRig

# Table 7.4.2 is in axes X left, Y up, Z forward; here it is in optical axes (x right, y down), so x and y change sign.
RIGHT_ROTATION_VECTOR = (0.01112, -0.03024, 0.00331)  # back camera in the front camera's frame [rad]
RIGHT_POSITION_M = (-0.00609478, 0.77596641, 0.00736704)

# Optical x is the body's right (-y), optical y its rear (-x), the optical axis points down (-z).
R_BODY_OPTICAL = np.array([[0.0, -1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
LEFT_LEVER_ARM_M = (0.2, 0.0, -0.1)  # front camera in the body; not in the thesis


def kagaru_rig(scale: float = 1.0) -> StereoRig:
    """Return the rig for images of `scale` times 1280 x 960 px.

    "Left" is the front camera, the reference. The baseline is along the flight direction, that is along the image's
    vertical: disparity is in v.
    """
    left = PinholeCamera(1280, 960, 1641.99751, 1642.30964, 642.15139, 470.34929)
    right = PinholeCamera(1280, 960, 1646.07299, 1645.39302, 620.74483, 477.47527)
    T_body_left = Pose(R_BODY_OPTICAL.copy(), np.array(LEFT_LEVER_ARM_M))
    T_left_right = Pose(so3_exp(RIGHT_ROTATION_VECTOR), np.array(RIGHT_POSITION_M))
    return StereoRig(scaled(left, scale), scaled(right, scale), T_body_left, T_body_left @ T_left_right)


def scaled(camera: PinholeCamera, scale: float) -> PinholeCamera:
    """Return the camera whose image is resized by `scale`: u' = (u + 0.5) scale - 0.5, pixel centres at integers."""
    return dataclasses.replace(
        camera,
        width=round(camera.width * scale),
        height=round(camera.height * scale),
        fx=camera.fx * scale,
        fy=camera.fy * scale,
        cx=(camera.cx + 0.5) * scale - 0.5,
        cy=(camera.cy + 0.5) * scale - 0.5,
    )


def rotated_right(rig: StereoRig, rotation_vector: np.ndarray) -> StereoRig:
    """Return the rig with its right camera rotated by a (3,) rotation vector [rad] in its own optical frame."""
    T_body_right = rig.T_body_right @ Pose(so3_exp(rotation_vector), np.zeros(3))
    return dataclasses.replace(rig, T_body_right=T_body_right)
