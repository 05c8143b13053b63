# SPDX-License-Identifier: Apache-2.0
"""Calibrations of other tools: the same rig from Kalibr's, OpenVINS's, ROS's and EuRoC's files."""

import itertools
import math
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml
from calibrated_rig import LEFT, RIG, RIGHT, T_BODY_LEFT, T_LEFT_RIGHT, assert_rig, setup_of

from uav_vslam.config import InputConfig, load_vehicle
from uav_vslam.config.input import FramesConfig
from uav_vslam.datasets.calibration_files import read_calibration
from uav_vslam.datasets.sensor_setup import SensorSetup, with_noise_of_files
from uav_vslam.errors import CalibrationError
from uav_vslam.geometry.camera import PinholeCamera
from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.rotation import so3_exp

NOISE = {
    "accelerometer_noise_density": 2e-3,
    "accelerometer_random_walk": 3e-3,
    "gyroscope_noise_density": 1.6e-4,
    "gyroscope_random_walk": 2.2e-5,
}


def written(path: Path, tree: dict[str, Any]) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(yaml.safe_dump(tree), encoding="utf-8")
    return path


def intrinsics(camera: PinholeCamera) -> list[float]:
    return [camera.fx, camera.fy, camera.cx, camera.cy]


def kalibr_camera(camera: PinholeCamera, **more: Any) -> dict[str, Any]:
    return {
        "camera_model": "pinhole",
        "intrinsics": intrinsics(camera),
        "distortion_model": "radtan",
        "distortion_coeffs": camera.distortion[:4].tolist(),
        "resolution": [camera.width, camera.height],
        **more,
    }


def kalibr(folder: Path, *, with_imu: bool = True) -> Path:
    at_imu = {"T_cam_imu": T_BODY_LEFT.inverse().matrix.tolist(), "timeshift_cam_imu": -0.004} if with_imu else {}
    chain = T_LEFT_RIGHT.inverse().matrix.tolist()
    tree = {"cam0": kalibr_camera(LEFT, **at_imu), "cam1": kalibr_camera(RIGHT, T_cn_cnm1=chain)}
    return written(folder / "camchain.yaml", tree)


def ros(folder: Path) -> list[Path]:
    """Both files as a stereo calibration of image_pipeline writes them, rectified by OpenCV."""
    T_right_left = T_LEFT_RIGHT.inverse()
    rectified = cv2.stereoRectify(
        LEFT.K, LEFT.distortion, RIGHT.K, RIGHT.distortion, (640, 480), T_right_left.R, T_right_left.t
    )
    paths = []
    for name, camera, R, P in zip(("left", "right"), (LEFT, RIGHT), rectified[:2], rectified[2:4], strict=True):
        tree = {
            "image_width": camera.width,
            "image_height": camera.height,
            "camera_name": name,
            "camera_matrix": {"rows": 3, "cols": 3, "data": camera.K.ravel().tolist()},
            "distortion_model": "plumb_bob",
            "distortion_coefficients": {"rows": 1, "cols": 5, "data": camera.distortion.tolist()},
            "rectification_matrix": {"rows": 3, "cols": 3, "data": R.ravel().tolist()},
            "projection_matrix": {"rows": 3, "cols": 4, "data": P.ravel().tolist()},
        }
        paths.append(written(folder / f"{name}.yaml", tree))
    return paths


def euroc(folder: Path) -> Path:
    for name, camera, pose in (("cam0", LEFT, RIG.T_body_left), ("cam1", RIGHT, RIG.T_body_right)):
        tree = {
            "T_BS": {"rows": 4, "cols": 4, "data": pose.matrix.ravel().tolist()},
            "resolution": [camera.width, camera.height],
            "intrinsics": intrinsics(camera),
            "distortion_model": "radial-tangential",
            "distortion_coefficients": camera.distortion[:4].tolist(),
        }
        written(folder / name / "sensor.yaml", tree)
    written(folder / "imu0" / "sensor.yaml", {"rate_hz": 200, **NOISE})
    return folder


def test_kalibrs_file_tells_all_of_the_rig_and_the_clock(tmp_path: Path) -> None:
    setup = setup_of(kalibr(tmp_path))
    assert not setup.needs_infos
    assert not setup.needs_frames
    assert setup.time_offset_ns == -4_000_000
    assert_rig(setup.rig())


def chain_of_four(folder: Path, *, without: str = "") -> Path:
    """Write a chain in which `LEFT` is cam1 and `RIGHT` is cam3, each camera in its place by that before."""
    first, second = (
        Pose(so3_exp([0.3, 0.0, 0.1]), np.array([0.5, 0.1, 0.0])),
        Pose(np.eye(3), np.array([0.1, 0.2, 0.3])),
    )
    poses = [first.inverse(), Pose.identity(), second, T_LEFT_RIGHT]  # in the left camera
    chain = [after.inverse() @ before for before, after in itertools.pairwise(poses)]
    tree = {f"cam{k}": kalibr_camera(LEFT if k < 3 else RIGHT) for k in range(4)}
    for k, T_camera_previous in enumerate(chain, start=1):
        tree[f"cam{k}"]["T_cn_cnm1"] = T_camera_previous.matrix.tolist()
    return written(folder / "camchain.yaml", {name: one for name, one in tree.items() if name != without})


def test_two_cameras_of_a_chain_of_four_are_chosen_by_name(tmp_path: Path) -> None:
    left, right = read_calibration([chain_of_four(tmp_path)], ["cam1", "cam3"]).cameras
    assert right.T_left_cam is not None
    np.testing.assert_allclose(right.T_left_cam.matrix, T_LEFT_RIGHT.matrix, atol=1e-12)
    assert (left.camera.fx, right.camera.fx) == (LEFT.fx, RIGHT.fx)


@pytest.mark.parametrize(
    ("names", "without", "reason"),
    [
        ([], "", "4 cameras; name the left and the right one of cam0, cam1, cam2, cam3 by input.cameras"),
        (["cam1", "cam4"], "", r"input.cameras \[cam1, cam4\] are not two of the names in .*: cam0, cam1, cam2, cam3"),
        (["cam1", "cam1"], "", "not two of the names"),
        (["cam0", "cam3"], "cam2", "cam3: the camera before, to which T_cn_cnm1 refers, is missing; keep all"),
    ],
)
def test_which_two_cameras_of_a_chain_is_not_guessed(
    names: list[str], without: str, reason: str, tmp_path: Path
) -> None:
    with pytest.raises(CalibrationError, match=reason):
        read_calibration([chain_of_four(tmp_path, without=without)], names)


def test_openvins_gives_each_cameras_pose_at_the_imu(tmp_path: Path) -> None:
    poses = {"cam0": (LEFT, RIG.T_body_left), "cam1": (RIGHT, RIG.T_body_right)}
    tree = {name: kalibr_camera(one, T_imu_cam=pose.matrix.tolist()) for name, (one, pose) in poses.items()}
    file = written(tmp_path / "kalibr_imucam_chain.yaml", tree)
    file.write_text(f"%YAML:1.0\n\n{file.read_text()}")
    assert_rig(setup_of(file).rig())


@pytest.mark.parametrize(("right_s", "told"), [(None, ""), (-0.0042, ""), (0.046, "exposed +50.0 ms from the left")])
def test_cameras_of_different_clocks_are_told(right_s: float | None, told: str, tmp_path: Path) -> None:
    file = kalibr(tmp_path)
    tree = yaml.safe_load(file.read_text())
    tree["cam1"] |= {} if right_s is None else {"timeshift_cam_imu": right_s}
    found = read_calibration([written(file, tree)])
    assert found.time_offset_s == -0.004
    assert (told in found.unequal_clocks) if told else not found.unequal_clocks


def test_eurocs_folder_tells_all_of_the_rig(tmp_path: Path) -> None:
    assert_rig(setup_of(euroc(tmp_path)).rig())


def test_eurocs_imu_may_be_elsewhere_than_its_body(tmp_path: Path) -> None:
    place = Pose(so3_exp([0.2, 0.1, -0.3]), np.array([0.1, 0.2, 0.3]))
    folder = euroc(tmp_path)
    written(folder / "imu0" / "sensor.yaml", {"T_BS": {"data": place.matrix.ravel().tolist()}, **NOISE})
    setup = setup_of(folder)
    assert_rig(setup.rig())
    np.testing.assert_allclose(setup.T_body_imu().matrix, place.matrix, atol=1e-12)


def test_the_body_may_be_another_frame_than_the_imu_of_the_files(tmp_path: Path) -> None:
    place = Pose(so3_exp([0.2, 0.1, -0.3]), np.array([0.1, 0.2, 0.3]))
    frames = FramesConfig(base="base_link", imu="imu_link")
    setup = SensorSetup.of("uav1", InputConfig(calibration=(kalibr(tmp_path),), frames=frames))
    assert setup.missing_transforms() == ["base_link -> imu_link"]
    setup.frames.add([("base_link", "imu_link", place)])
    np.testing.assert_allclose(setup.rig().T_body_left.matrix, (place @ T_BODY_LEFT).matrix, atol=1e-9)
    np.testing.assert_allclose(setup.T_body_imu().matrix, place.matrix, atol=1e-9)
    assert setup.conflict("base_link") == ""


def test_a_state_of_another_frame_than_the_imu_of_the_files_is_noticed(tmp_path: Path) -> None:
    setup = setup_of(kalibr(tmp_path))
    assert setup.conflict("base_link") == ""  # nothing is known of the IMU's frame
    setup.imu_frame = "imu_link"
    assert "input.frames.base: base_link" in setup.conflict("base_link")
    assert setup.conflict("imu_link") == setup.conflict("") == ""


@pytest.mark.parametrize("kind", ["kalibr without IMU", "ros"])
def test_files_of_the_cameras_alone_leave_their_place_to_the_static_frames(kind: str, tmp_path: Path) -> None:
    setup = setup_of(*(ros(tmp_path) if kind == "ros" else [kalibr(tmp_path, with_imu=False)]))
    setup.imu_frame = "uav1/base_link"
    assert setup.missing_infos == ["left"]  # which names the camera's frame
    setup.cameras["left"] = (LEFT, "eye")
    assert setup.missing_transforms() == ["uav1/base_link -> eye"]
    setup.frames.add([("uav1/base_link", "eye", T_BODY_LEFT)])
    assert setup.missing_transforms() == []
    assert_rig(setup.rig())


@pytest.mark.parametrize("R", [np.eye(3), np.zeros((3, 3))], ids=["rectified alone", "R is not filled in"])
def test_cameras_that_were_calibrated_alone_leave_their_places_to_the_static_frames(
    R: np.ndarray, tmp_path: Path
) -> None:
    for path, camera in zip(ros(tmp_path), (LEFT, RIGHT), strict=True):
        tree = yaml.safe_load(path.read_text())
        tree["rectification_matrix"]["data"] = R.ravel().tolist()
        tree["distortion_coefficients"]["data"] = [*camera.distortion.tolist(), 0.0, 0.0, 0.0]
        tree["projection_matrix"]["data"] = np.column_stack([LEFT.K, np.zeros(3)]).ravel().tolist()
        written(path, tree)
    setup = setup_of(tmp_path / "left.yaml", tmp_path / "right.yaml")
    setup.imu_frame = "uav1/base_link"
    for side, camera, T in (("left", LEFT, RIG.T_body_left), ("right", RIGHT, RIG.T_body_right)):
        setup.cameras[side] = (camera, side)
        setup.frames.add([("uav1/base_link", side, T)])
    assert_rig(setup.rig())


def test_the_noise_of_a_file_counts_where_the_configuration_sets_none(tmp_path: Path) -> None:
    files = [str(kalibr(tmp_path)), str(written(tmp_path / "imu.yaml", {"imu0": NOISE}))]
    config = load_vehicle(None, overrides={"input.calibration": files, "imu.gyro_noise": 5e-4})
    found = with_noise_of_files(config).imu
    assert (found.gyro_noise, found.accel_noise) == (5e-4, 2e-3)
    assert (found.gyro_bias_walk, found.accel_bias_walk) == (2.2e-5, 3e-3)


def test_paths_in_a_configuration_are_relative_to_it(tmp_path: Path) -> None:
    kalibr(tmp_path / "deep")
    tree = {"/**": {"ros__parameters": {"input": {"calibration": ["camchain.yaml"]}}}}
    config = load_vehicle(written(tmp_path / "deep" / "mine.yaml", tree))
    assert config.input.calibration == (tmp_path / "deep" / "camchain.yaml",)


WRONG: dict[str, tuple[Any, str]] = {
    "no calibration": ({"speed": 3}, "no calibration of Kalibr, OpenVINS,"),
    "omnidirectional": ({"cam0": kalibr_camera(LEFT) | {"camera_model": "omni"}}, "camera_model 'omni'"),
    "unknown lens": ({"cam0": kalibr_camera(LEFT) | {"distortion_model": "fov"}}, "'fov' is not supported"),
    "no intrinsics": ({"cam0": {"camera_model": "pinhole"}}, "resolution is missing"),
    "words for numbers": ({"cam0": kalibr_camera(LEFT) | {"intrinsics": ["a", 1, 2, 3]}}, "malformed"),
    "transposed": (
        {"cam0": kalibr_camera(LEFT) | {"T_cam_imu": RIG.T_body_left.matrix.T.tolist()}},
        r"cam0: T_cam_imu is no rotation and translation: .* by rows",
    ),
    "no rotation": ({"cam0": kalibr_camera(LEFT) | {"T_cam_imu": np.diag([1, 1.02, 1, 1]).tolist()}}, "no rotation"),
    "place that is none": ({"cam0": kalibr_camera(LEFT) | {"T_cam_imu": np.eye(4)[:2].tolist()}}, "no rotation"),
    "coefficients without data": (
        {"camera_matrix": {"data": [1.0] * 9}, "image_width": 9, "image_height": 9, "distortion_coefficients": [0.0]},
        "malformed",
    ),
    "endless": ({"cam0": kalibr_camera(LEFT) | {"resolution": [math.inf, 480]}}, "malformed"),
    "number for a key": ({"cam0": kalibr_camera(LEFT), 1: kalibr_camera(RIGHT)}, "malformed"),
    "no clock": ({"cam0": kalibr_camera(LEFT) | {"timeshift_cam_imu": math.nan}}, "timeshift_cam_imu is nan"),
    "three cameras": ({f"cam{k}": kalibr_camera(LEFT) for k in range(3)}, "3 cameras"),
}


@pytest.mark.parametrize("case", WRONG)
def test_a_wrong_file_is_named_with_what_is_wrong(case: str, tmp_path: Path) -> None:
    tree, text = WRONG[case]
    path = written(tmp_path / "given.yaml", tree)
    with pytest.raises(CalibrationError, match=text) as refused:
        read_calibration([path])
    assert str(path) in str(refused.value)


def test_a_missing_file_and_a_folder_of_something_else_are_named(tmp_path: Path) -> None:
    with pytest.raises(CalibrationError, match=r"none\.yaml: can't be read"):
        read_calibration([tmp_path / "none.yaml"])
    with pytest.raises(CalibrationError, match=r"a folder without cam0/sensor\.yaml"):
        read_calibration([tmp_path])
