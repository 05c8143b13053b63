# SPDX-License-Identifier: Apache-2.0
"""Calibrations in settings of ORB-SLAM3 and VINS-Fusion: the same rig as from other tools' files."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest
from calibrated_rig import LEFT, RIG, RIGHT, T_LEFT_RIGHT, assert_rig, setup_of

from uav_vslam.datasets.calibration_files import read_calibration
from uav_vslam.errors import CalibrationError
from uav_vslam.geometry.camera import PinholeCamera
from uav_vslam.geometry.pose import Pose


def matrix(pose: Pose) -> str:
    numbers = ", ".join(map(repr, pose.matrix.ravel().tolist()))
    return f"!!opencv-matrix\n   rows: 4\n   cols: 4\n   dt: f\n   data: [{numbers}]"


def settings(path: Path, values: Mapping[str, object]) -> Path:
    path.write_text("%YAML:1.0\n---\n# settings\n" + "".join(f"{key}: {value}\n" for key, value in values.items()))
    return path


def projection(camera: PinholeCamera) -> dict[str, float]:
    return {"fx": camera.fx, "fy": camera.fy, "cx": camera.cx, "cy": camera.cy}


def distortion(camera: PinholeCamera) -> dict[str, float]:
    return dict(zip(("k1", "k2", "p1", "p2"), camera.distortion[:4].tolist(), strict=True))


def orb_slam_camera(name: str, camera: PinholeCamera) -> dict[str, object]:
    return {f"{name}.{key}": value for key, value in (projection(camera) | distortion(camera)).items()}


ORB_SLAM = {
    "File.version": '"1.0"',
    "Camera.type": '"PinHole"',
    **orb_slam_camera("Camera1", LEFT),
    **orb_slam_camera("Camera2", RIGHT),
    "Camera.width": LEFT.width,
    "Camera.height": LEFT.height,
    "Stereo.ThDepth": 60.0,
    "Stereo.T_c1_c2": matrix(T_LEFT_RIGHT),
    "IMU.T_b_c1": matrix(RIG.T_body_left),
    "IMU.NoiseGyro": 1.7e-4,
    "IMU.NoiseAcc": 2.0e-3,
    "IMU.GyroWalk": 1.9e-5,
    "IMU.AccWalk": 3.0e-3,
    "IMU.Frequency": 200.0,
}


def vins(folder: Path, *, model_type: str = "PINHOLE", **more: object) -> Path:
    for index, one in enumerate((LEFT, RIGHT)):
        values = {
            "model_type": model_type,
            "image_width": one.width,
            "image_height": one.height,
            "distortion_parameters": distortion(one),
            "projection_parameters": projection(one),
        }
        settings(folder / f"cam{index}_pinhole.yaml", values)
    poses = {"body_T_cam0": matrix(RIG.T_body_left), "body_T_cam1": matrix(RIG.T_body_right)}
    calibrations = {f"cam{index}_calib": f'"cam{index}_pinhole.yaml"' for index in range(2)}
    values = {"imu": 1, "num_of_cam": 2, **calibrations, **poses, "acc_n": 0.1, "td": 0.004, **more}
    return settings(folder / "stereo_imu.yaml", values)


def test_orb_slam_tells_all_of_the_rig_and_the_noise(tmp_path: Path) -> None:
    file = settings(tmp_path / "EuRoC.yaml", ORB_SLAM)
    assert_rig(setup_of(file).rig())
    noise = {"gyro_noise": 1.7e-4, "accel_noise": 2e-3, "gyro_bias_walk": 1.9e-5, "accel_bias_walk": 3e-3}
    assert read_calibration([file]).noise == {f"imu.{name}": value for name, value in noise.items()}


def test_orb_slams_rectified_pair_has_one_lens_and_a_baseline(tmp_path: Path) -> None:
    rectified = {key: value for key, value in ORB_SLAM.items() if not key.startswith(("Camera2", "Stereo.T"))}
    rig = setup_of(settings(tmp_path / "a.yaml", {**rectified, "Camera.type": "Rectified", "Stereo.b": 0.12})).rig()
    np.testing.assert_array_equal(rig.right.K, LEFT.K)
    assert not rig.left.distortion.any()
    T_left_right = rig.T_body_left.inverse() @ rig.T_body_right
    np.testing.assert_allclose(T_left_right.matrix, Pose(np.eye(3), np.array([0.12, 0, 0])).matrix, atol=1e-12)


def test_orb_slams_fisheyes_are_equidistant(tmp_path: Path) -> None:
    fisheyes = {**ORB_SLAM, "Camera.type": "KannalaBrandt8", "Camera1.k3": 0.3, "Camera1.k4": 0.4}
    left = read_calibration([settings(tmp_path / "a.yaml", fisheyes)]).cameras[0].camera
    assert (left.model, left.distortion.tolist()) == ("equidistant", [-0.1, 0.02, 0.3, 0.4])


def test_vins_tells_all_of_the_rig_and_the_clock_with_its_cameras_files(tmp_path: Path) -> None:
    file = vins(tmp_path)
    setup = setup_of(file)
    assert_rig(setup.rig())
    assert setup.time_offset_ns == 4_000_000
    assert not read_calibration([file]).noise


def test_vins_fisheyes_are_equidistant(tmp_path: Path) -> None:
    file = vins(tmp_path)
    projection = "{k2: 0.1, k3: 0.2, k4: 0.3, k5: 0.4, mu: 400.0, mv: 401.0, u0: 320.0, v0: 240.0}"
    values = {"model_type": "KANNALA_BRANDT", "image_width": 640, "image_height": 480}
    settings(tmp_path / "cam0_pinhole.yaml", {**values, "projection_parameters": projection})
    left = read_calibration([file]).cameras[0].camera
    assert (left.model, left.distortion.tolist()) == ("equidistant", [0.1, 0.2, 0.3, 0.4])
    np.testing.assert_array_equal(left.K, LEFT.K)


def test_what_is_wrong_with_settings_is_named(tmp_path: Path) -> None:
    def said(path: Path) -> str:
        with pytest.raises(CalibrationError) as caught:
            read_calibration([path])
        return str(caught.value)

    lacking = {key: value for key, value in ORB_SLAM.items() if key != "Camera2.fy"}
    assert said(settings(tmp_path / "a.yaml", lacking)) == f"{tmp_path / 'a.yaml'}: Camera2.fy is missing"
    assert "Camera.type 'Fish' is not supported" in said(
        settings(tmp_path / "b.yaml", {**ORB_SLAM, "Camera.type": "Fish"})
    )
    assert "model_type 'MEI' is not supported; use PINHOLE" in said(vins(tmp_path, model_type="MEI"))
    assert "td is nan" in said(vins(tmp_path, td=".nan"))
    file = vins(tmp_path)
    (tmp_path / "cam1_pinhole.yaml").unlink()
    assert "cam1_pinhole.yaml: can't be read (No such file or directory)" in said(file)
