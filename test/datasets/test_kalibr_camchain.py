# SPDX-License-Identifier: Apache-2.0
"""A camchain that is written is read as the same rig."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from board_scene import rig_of

from uav_vslam.datasets.calibration_files import read_calibration
from uav_vslam.errors import CalibrationError
from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.rotation import so3_exp
from uav_vslam.studies.recordings.foreign import write_kalibr

T_BODY_IMU = Pose(so3_exp([0.3, -0.2, 0.1]), np.array([0.1, -0.05, 0.02]))
OFFSET_S = -0.004


@pytest.mark.parametrize("model", ["plumb_bob", "equidistant"])
def test_a_camchain_with_an_imu_tells_the_rig_in_the_imus_frame(model: str, tmp_path: Path) -> None:
    rig = rig_of(model)
    file = write_kalibr(rig, tmp_path, timeshift_s=OFFSET_S, T_body_imu=T_BODY_IMU)
    found = read_calibration([file])
    assert found.time_offset_s == OFFSET_S
    cameras = ((rig.left, rig.T_body_left), (rig.right, rig.T_body_right))
    for index, (camera, T_body_cam) in enumerate(cameras):
        assert found.cameras[index].camera.model == model
        np.testing.assert_allclose(found.cameras[index].camera.distortion, camera.distortion)
        T_imu_cam = found.T_body_cam(index)
        assert T_imu_cam is not None
        np.testing.assert_allclose((T_BODY_IMU @ T_imu_cam).matrix, T_body_cam.matrix, atol=1e-12)
    T_left_right = found.cameras[1].T_left_cam
    assert T_left_right is not None
    np.testing.assert_allclose(T_left_right.matrix, rig.T_right_left.inverse().matrix, atol=1e-12)


def test_a_lens_is_never_written_without_some_of_its_coefficients(tmp_path: Path) -> None:
    rig = rig_of()
    fifth = dataclasses.replace(rig.left, distortion=np.array([0.1, 0.0, 0.0, 0.0, 0.01]))
    with pytest.raises(CalibrationError, match="Kalibr has no plumb_bob and plumb_bob lenses with these coefficients"):
        write_kalibr(dataclasses.replace(rig, left=fifth), tmp_path)
