# SPDX-License-Identifier: Apache-2.0
"""A rig that calibration files of all kinds describe."""

from pathlib import Path

import numpy as np

from uav_vslam.config import InputConfig
from uav_vslam.datasets.sensor_setup import SensorSetup
from uav_vslam.geometry.camera import PinholeCamera
from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.rotation import so3_exp
from uav_vslam.geometry.stereo import StereoRig

LEFT = PinholeCamera(640, 480, 400.0, 401.0, 320.0, 240.0, np.array([-0.1, 0.02, 1e-3, -1e-3, 0.0]))
RIGHT = PinholeCamera(640, 480, 405.0, 406.0, 318.0, 242.0, np.array([-0.1, 0.03, 1e-3, 1e-3, 0.0]))
T_BODY_LEFT = Pose(so3_exp([0.1, -2.0, 0.5]), np.array([0.2, -0.1, 0.05]))
T_LEFT_RIGHT = Pose(so3_exp([0.01, -0.02, 0.005]), np.array([0.11, 0.002, -0.003]))
RIG = StereoRig(LEFT, RIGHT, T_BODY_LEFT, T_BODY_LEFT @ T_LEFT_RIGHT)


def assert_rig(rig: StereoRig) -> None:
    for ours, true in ((rig.left, LEFT), (rig.right, RIGHT)):
        np.testing.assert_allclose(ours.K, true.K)
        np.testing.assert_allclose(ours.distortion, true.distortion)
    np.testing.assert_allclose(rig.T_body_left.matrix, RIG.T_body_left.matrix, atol=1e-9)
    np.testing.assert_allclose(rig.T_body_right.matrix, RIG.T_body_right.matrix, atol=1e-9)


def setup_of(*paths: Path) -> SensorSetup:
    return SensorSetup.of("uav1", InputConfig(calibration=paths))
