# SPDX-License-Identifier: Apache-2.0
"""An ASL folder becomes a flight with consistent ground truth, IMU readings and images."""

import itertools
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from uav_vslam.cli.main import main
from uav_vslam.datasets.bag import open_flight
from uav_vslam.datasets.cdr import decode
from uav_vslam.datasets.flight_writer import SourceFrame
from uav_vslam.datasets.importing.euroc import read_euroc
from uav_vslam.datasets.importing.motion import InitialSigma
from uav_vslam.datasets.importing.problems import Problems
from uav_vslam.datasets.rosbag import iter_raw
from uav_vslam.errors import BagError, CalibrationError
from uav_vslam.geometry.rotation import so3_exp, so3_log
from uav_vslam.types import ImuSample, StereoFrame

GRAVITY = np.array([0.0, 0.0, -9.81])
INS_POSITION_M = 0.15  # after 1 s, with biases that are 40 s old; a wrong axis or sign of gravity gives metres
INS_ATTITUDE_RAD = np.deg2rad(0.5)

SENSOR = """%YAML:1.0
T_BS:
  cols: 4
  rows: 4
  data: [0.0, -1.0, 0.0, {x}, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0]
resolution: [64, 48]
camera_model: pinhole
intrinsics: [50.0, 51.0, 32.0, 24.0]
distortion_model: {model}
distortion_coefficients: [-0.3, 0.1, 0.001, 0.002]
"""


def write_sequence(
    mav0: Path, *, model: str = "radial-tangential", image_ns: tuple[int, ...] = (100, 200, 300)
) -> Path:
    """Write a still camera's ASL folder with `image_ns` in units of 1 ms and truth from 150 ms on."""
    stamps = [ms * 1_000_000 for ms in image_ns]
    for number, camera in enumerate(("cam0", "cam1")):
        (mav0 / camera / "data").mkdir(parents=True)
        (mav0 / camera / "sensor.yaml").write_text(SENSOR.format(x=0.1 * number, model=model))
        rows = [f"{s},{s}.png" for s in stamps]
        (mav0 / camera / "data.csv").write_text("\n".join(["#timestamp [ns],filename", *rows]) + "\n")
        for s in stamps:
            cv2.imwrite(str(mav0 / camera / "data" / f"{s}.png"), np.full((48, 64), s % 251 + number, np.uint8))
    (mav0 / "imu0").mkdir()
    readings = [f"{ms * 1_000_000},0.01,0.0,0.0,0.0,0.0,9.81" for ms in range(0, 400, 5)]
    (mav0 / "imu0" / "data.csv").write_text("\n".join(["#header", *readings]))
    (mav0 / "state_groundtruth_estimate0").mkdir()
    truth = [f"{ms * 1_000_000},{ms},2,3,1,0,0,0,4,5,6,.01,.02,.03,.1,.2,.3" for ms in range(150, 400, 20)]
    (mav0 / "state_groundtruth_estimate0" / "data.csv").write_text("\n".join(["#header", *truth]))
    return mav0


def test_a_sequence_starts_at_the_first_image_with_ground_truth(tmp_path: Path) -> None:
    mav0 = write_sequence(tmp_path / "mav0")
    flight = read_euroc(mav0, vehicle="uav3").flight
    frames = list(flight.frames)
    assert [f.stamp_ns for f in frames] == [200_000_000, 300_000_000]
    assert isinstance(frames[0], SourceFrame)
    assert frames[0].left.content == (mav0 / "cam0" / "data" / "200000000.png").read_bytes()
    assert frames[0].right.content == (mav0 / "cam1" / "data" / "200000000.png").read_bytes()
    assert flight.initial is not None
    state = flight.initial.state
    assert state.stamp_ns == 200_000_000
    np.testing.assert_allclose(state.T_map_body.t, [200.0, 2.0, 3.0])  # between the rows of 190 and 210 ms
    np.testing.assert_allclose(state.v_map, [4.0, 5.0, 6.0])
    np.testing.assert_allclose(state.gyro_bias, [0.01, 0.02, 0.03])
    np.testing.assert_allclose(state.accel_bias, [0.1, 0.2, 0.3])


def test_only_images_between_the_first_and_the_last_reading_count(tmp_path: Path) -> None:
    mav0 = write_sequence(tmp_path / "mav0", image_ns=(200, 300, 350))
    readings = (mav0 / "imu0" / "data.csv").read_text().splitlines()
    (mav0 / "imu0" / "data.csv").write_text("\n".join(readings[45:65]))  # 220 to 315 ms
    source = read_euroc(mav0)
    assert [f.stamp_ns for f in source.flight.frames] == [300_000_000]
    assert source.notes == ("2 image pairs before or after the IMU's readings are left out",)
    (mav0 / "imu0" / "data.csv").write_text("\n".join(readings[1:10]))
    with pytest.raises(BagError, match=r"none of 3 .* from 0\.200 to 0\.350 s, IMU readings from 0\.000 to"):
        read_euroc(mav0)


def test_calibration_is_read_with_all_its_terms(tmp_path: Path) -> None:
    rig = read_euroc(write_sequence(tmp_path / "mav0")).flight.rig
    assert (rig.left.width, rig.left.height, rig.left.fx, rig.left.cy) == (64, 48, 50.0, 24.0)
    np.testing.assert_array_equal(rig.left.distortion, [-0.3, 0.1, 0.001, 0.002, 0.0])
    np.testing.assert_array_equal(rig.T_body_left.R, [[0, -1, 0], [1, 0, 0], [0, 0, 1]])
    np.testing.assert_allclose(rig.T_body_right.t, [0.1, 0.0, 0.0])


def test_the_stated_sigma_is_the_covariance(tmp_path: Path) -> None:
    sigma = InitialSigma(0.1, 0.2, 1.0, 0.01, 0.02)
    initial = read_euroc(write_sequence(tmp_path / "mav0"), sigma=sigma).flight.initial
    assert initial is not None
    expected = np.repeat([0.1, 0.2, np.deg2rad(1.0), 0.01, 0.02], 3)
    np.testing.assert_allclose(np.sqrt(np.diag(initial.covariance)), expected)


def test_only_images_with_equal_stamps_pair(tmp_path: Path) -> None:
    mav0 = write_sequence(tmp_path / "mav0")
    text = (mav0 / "cam1" / "data.csv").read_text()
    (mav0 / "cam1" / "data.csv").write_text(text.replace("200000000,", "200000001,"))
    problems = Problems()
    assert [f.stamp_ns for f in read_euroc(mav0, problems=problems).flight.frames] == [300_000_000]
    assert problems.counts == {"pictures without a partner": 2}


def test_the_folder_that_an_archive_unpacks_to_will_do(tmp_path: Path) -> None:
    write_sequence(tmp_path / "V1_01_easy" / "mav0")
    assert read_euroc(tmp_path / "V1_01_easy").frame_count == 2


def test_lenses_may_be_fisheyes(tmp_path: Path) -> None:
    rig = read_euroc(write_sequence(tmp_path / "mav0", model="equidistant")).flight.rig
    assert rig.right.model == "equidistant"
    np.testing.assert_array_equal(rig.right.distortion, [-0.3, 0.1, 0.001, 0.002])


def test_a_sequence_without_ground_truth_starts_in_flight(tmp_path: Path) -> None:
    mav0 = write_sequence(tmp_path / "mav0")
    shutil.rmtree(mav0 / "state_groundtruth_estimate0")
    source = read_euroc(mav0)
    assert (source.flight.initial, source.flight.truth, source.frame_count) == (None, (), 3)
    assert source.settings == {"start.method": "in_flight"}
    assert source.notes == ("no state_groundtruth_estimate0: start.method is in_flight, and nothing can be evaluated",)


def test_errors_name_what_is_wrong_with_a_folder(tmp_path: Path) -> None:
    with pytest.raises(BagError, match="has no folder cam0"):
        read_euroc(tmp_path / "nowhere")
    with pytest.raises(CalibrationError, match=r"sensor\.yaml: distortion model 'omni' is not supported"):
        read_euroc(write_sequence(tmp_path / "mirror", model="omni"))
    with pytest.raises(BagError, match="none of 2 image pairs is covered by IMU readings and ground truth: pairs from"):
        read_euroc(write_sequence(tmp_path / "early", image_ns=(10, 20)))
    with pytest.raises(BagError, match="no pictures of the two cameras pair up"):
        read_euroc(write_sequence(tmp_path / "none", image_ns=()))
    broken = write_sequence(tmp_path / "broken")
    (broken / "imu0" / "data.csv").write_text("1,2,3\n")
    with pytest.raises(BagError, match="6 numbers"):
        read_euroc(broken)


@pytest.fixture(scope="module")
def euroc_mav0(data_root: Path) -> Path:
    return data_root / "euroc_v101_keyframes" / "mav0"


@pytest.fixture(scope="module")
def imported(euroc_mav0: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("euroc") / "v101"
    assert main(["import", "euroc", str(euroc_mav0), str(out)]) == 0
    return out


@pytest.mark.slow
@pytest.mark.data
def test_a_real_sequence_is_imported_completely(imported: Path, euroc_mav0: Path) -> None:
    flight = open_flight(imported, "uav1")
    events = list(flight.iter_events())
    frames = [e for e in events if isinstance(e, StereoFrame)]
    assert len(frames) == flight.frame_count == 100
    assert sum(isinstance(e, ImuSample) for e in events) == 29_120
    assert frames[0].left.shape == (480, 752)
    assert flight.rig.baseline_m == pytest.approx(0.110, abs=1e-3)
    truth = flight.truth()
    assert truth is not None
    assert len(truth) == 2895
    first = next(iter_raw([imported], ["/uav1/left/image_raw/compressed"]))
    file = euroc_mav0 / "cam0" / "data" / f"{frames[0].stamp_ns}.jpg"
    assert decode(first).data.tobytes() == file.read_bytes()


@pytest.mark.data
def test_dead_reckoning_on_real_readings_follows_the_ground_truth(imported: Path) -> None:
    """Axes of ground truth, gravity and IMU agree: dead reckoning holds for a second of flight."""
    flight = open_flight(imported, "uav1")
    truth = flight.truth()
    assert truth is not None
    assert flight.initial_state is not None
    state = flight.initial_state.state
    start = int(np.searchsorted(truth.stamps_ns, state.stamp_ns + 40_000_000_000))  # well in the air
    R, p, v = truth.R_world_body[start], truth.positions_world[start], truth.velocities_world[start]
    samples = [e for e in flight.iter_events() if isinstance(e, ImuSample)]
    samples = [s for s in samples if truth.stamps_ns[start] <= s.stamp_ns <= truth.stamps_ns[start + 20]]
    for a, b in itertools.pairwise(samples):
        dt = (b.stamp_ns - a.stamp_ns) * 1e-9
        rate = 0.5 * (a.gyro + b.gyro) - state.gyro_bias
        force = 0.5 * (a.accel + b.accel) - state.accel_bias
        acceleration = R @ so3_exp(0.5 * dt * rate) @ force + GRAVITY
        p, v, R = p + v * dt + 0.5 * acceleration * dt**2, v + acceleration * dt, R @ so3_exp(rate * dt)
    assert np.linalg.norm(p - truth.positions_world[start + 20]) < INS_POSITION_M
    assert np.linalg.norm(so3_log(R @ truth.R_world_body[start + 20].T)) < INS_ATTITUDE_RAD
