# SPDX-License-Identifier: Apache-2.0
"""What is written is read by `input.calibration` as the same cameras."""

from pathlib import Path

import numpy as np
import pytest
from board_scene import T_LEFT_RIGHT, rig_of

from uav_vslam.calibration.files import write_calibration
from uav_vslam.datasets.calibration_files import read_calibration
from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.stereo import StereoRig

VERTICAL = Pose(T_LEFT_RIGHT.R, np.array([0.003, 0.3, 0.01]))


def assert_same(rig: StereoRig, files: list[Path]) -> None:
    left, right = read_calibration(files).cameras
    for found, true in ((left.camera, rig.left), (right.camera, rig.right)):
        assert (found.width, found.height, found.model) == (true.width, true.height, true.model)
        np.testing.assert_allclose(found.K, true.K)
        np.testing.assert_allclose(found.distortion, true.distortion)
    assert right.T_left_cam is not None
    np.testing.assert_allclose(right.T_left_cam.matrix, rig.T_body_right.matrix, atol=1e-9)


@pytest.mark.parametrize("model", ["plumb_bob", "rational_polynomial", "equidistant"])
@pytest.mark.parametrize("T_left_right", [T_LEFT_RIGHT, VERTICAL], ids=["side by side", "one behind the other"])
def test_each_kind_of_file_tells_the_rig(model: str, T_left_right: Pose, tmp_path: Path) -> None:
    rig = rig_of(model, T_left_right)
    left, right, *kalibr = write_calibration(rig, tmp_path)
    assert_same(rig, [left, right])
    if kalibr:
        assert_same(rig, kalibr)
    assert bool(kalibr) == (model != "rational_polynomial")  # of which Kalibr knows nothing


def test_kalibr_is_not_told_of_a_lens_without_its_third_coefficient(tmp_path: Path) -> None:
    rig = rig_of()
    rig.left.distortion[4] = 0.01
    assert [path.name for path in write_calibration(rig, tmp_path)] == ["left.yaml", "right.yaml"]
