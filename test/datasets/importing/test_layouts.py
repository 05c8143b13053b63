# SPDX-License-Identifier: Apache-2.0
"""A flight written as TUM-VI or KITTI have it comes back: calibration, stamps, pixels, readings, truth and start."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
import yaml
from data_sets import Flight, fisheye_rig, fly, rectified_rig, write_direct, write_kitti, write_tumvi

from uav_vslam.cli.main import main
from uav_vslam.config import load_vehicle
from uav_vslam.datasets.bag import open_flight
from uav_vslam.datasets.bag_flight import BagFlight
from uav_vslam.datasets.importing.kitti import T_FLU_OPTICAL, read_kitti
from uav_vslam.datasets.importing.problems import Problems
from uav_vslam.datasets.importing.tumvi import read_tumvi
from uav_vslam.datasets.rosbag import topics_of
from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.stereo import StereoRig
from uav_vslam.types import ImuSample, StereoFrame

Capsys = pytest.CaptureFixture[str]

POSE = 1e-9  # of rotations and positions that went through text and two compositions
VELOCITY = 0.01  # [m/s] of differences over 0.1 s in a turn


@pytest.fixture(scope="module")
def fisheye() -> Flight:
    return fly(fisheye_rig())


@pytest.fixture(scope="module")
def rectified() -> Flight:
    return fly(rectified_rig())


@pytest.fixture(scope="module")
def tumvi(fisheye: Flight, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_tumvi(fisheye, tmp_path_factory.mktemp("tumvi"))


@pytest.fixture(scope="module")
def kitti(rectified: Flight, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    return write_kitti(rectified, tmp_path_factory.mktemp("kitti"))


def imported(*arguments: str | Path, out: Path) -> BagFlight:
    name, source, *options = map(str, arguments)
    assert main(["import", name, source, str(out), *options]) == 0
    return open_flight(out, "uav1")


def assert_same_rig(found: StereoRig, true: StereoRig) -> None:
    for ours, theirs in ((found.left, true.left), (found.right, true.right)):
        assert (ours.width, ours.height, ours.model) == (theirs.width, theirs.height, theirs.model)
        np.testing.assert_allclose(ours.K, theirs.K, rtol=1e-14)
        np.testing.assert_array_equal(ours.distortion, theirs.distortion)
    np.testing.assert_allclose(found.T_body_left.matrix, true.T_body_left.matrix, atol=POSE)
    np.testing.assert_allclose(found.T_body_right.matrix, true.T_body_right.matrix, atol=POSE)


def assert_same_events(found: BagFlight, true: Flight, *, gain: int = 1) -> None:
    events = list(found.iter_events())
    readings = [event for event in events if isinstance(event, ImuSample)]
    frames = [event for event in events if isinstance(event, StereoFrame)]
    imu = true.vehicle.imu
    np.testing.assert_array_equal([sample.stamp_ns for sample in readings], imu.stamps_ns)
    np.testing.assert_array_equal([sample.gyro for sample in readings], imu.gyro)
    np.testing.assert_array_equal([sample.accel for sample in readings], imu.accel)
    assert [frame.stamp_ns for frame in frames] == [frame.stamp_ns for frame in true.frames]
    for ours, theirs in zip(frames, true.frames, strict=True):
        np.testing.assert_array_equal(ours.left, gain * theirs.left.astype(ours.left.dtype))
        np.testing.assert_array_equal(ours.right, gain * theirs.right.astype(ours.right.dtype))


def assert_true_motion(found: BagFlight, true: Flight, *, origin: np.ndarray | None = None) -> None:
    track, state, start = found.truth(), found.initial_state, true.start
    offset = np.zeros(3) if origin is None else origin
    assert track is not None
    assert state is not None
    for stamp, R, p in zip(track.stamps_ns, track.R_world_body, track.positions_world, strict=True):
        expected = true.vehicle.true_state(int(stamp)).T_map_body
        np.testing.assert_allclose(R, expected.R, atol=1e-6)
        np.testing.assert_allclose(p, expected.t - offset, atol=1e-6)
    assert state.state.stamp_ns == start.stamp_ns
    np.testing.assert_allclose(state.state.T_map_body.R, start.T_map_body.R, atol=1e-6)
    np.testing.assert_allclose(state.state.T_map_body.t, start.T_map_body.t - offset, atol=1e-6)
    np.testing.assert_allclose(state.state.v_map, start.v_map, atol=VELOCITY)


@pytest.mark.slow
def test_a_tumvi_sequence_comes_back(fisheye: Flight, tumvi: Path, tmp_path: Path) -> None:
    found = imported("tumvi", tumvi, out=tmp_path / "out")
    assert_same_rig(found.rig, fisheye.vehicle.rig)
    assert_same_events(found, fisheye, gain=257)
    assert_true_motion(found, fisheye)
    config = load_vehicle(tmp_path / "out.yaml")
    assert (config.imu.gyro_noise, config.imu.accel_noise) == (1.6e-4, 2.8e-3)


def test_kalibrs_clock_offset_moves_the_images_to_the_imus_clock(
    fisheye: Flight, tmp_path: Path, capsys: Capsys
) -> None:
    folder = write_tumvi(fisheye, tmp_path / "late", timeshift_s=-0.02)
    found = imported("tumvi", folder, out=tmp_path / "out")
    assert "-20.000 ms" in capsys.readouterr().out
    stamps = [event.stamp_ns for event in found.iter_events() if isinstance(event, StereoFrame)]
    assert set(stamps) <= {frame.stamp_ns for frame in fisheye.frames}
    assert len(stamps) == len(fisheye.frames)


def test_what_is_wrong_in_a_tumvi_sequence_is_one_line(fisheye: Flight, tmp_path: Path, capsys: Capsys) -> None:
    folder = write_tumvi(fisheye, tmp_path / "tumvi")
    chain, poses = folder / "dso" / "camchain.yaml", folder / "mav0" / "mocap0" / "data.csv"
    tree = yaml.safe_load(chain.read_text())
    tree["cam0"]["timeshift_cam_imu"] = 5.0
    for source, path, text, said in (
        (folder / "mav0", chain, chain.read_text(), "mav0 has no folder mav0; give the folder that holds it"),
        (
            folder,
            chain,
            yaml.safe_dump(tree),
            "ground truth from 1283212800.000 to 1283212803.221 s (images are",
        ),
        (folder, poses, "#timestamp,x\n", "mocap0/data.csv: no row holds a stamp and 7 numbers; without this file"),
    ):
        before = path.read_text()
        path.write_text(text)
        assert main(["import", "tumvi", str(source), str(tmp_path / "out")]) == 2
        path.write_text(before)
        error = capsys.readouterr().err
        assert said in error
        assert error.count("\n") == 1


def test_a_tumvi_sequence_without_poses_starts_in_flight(tumvi: Path, tmp_path: Path, capsys: Capsys) -> None:
    mocap = tumvi / "mav0" / "mocap0"
    mocap.rename(tumvi / "mav0" / "none")
    try:
        found = imported("tumvi", tumvi, out=tmp_path / "out")
    finally:
        (tumvi / "mav0" / "none").rename(mocap)
    assert found.initial_state is None
    assert found.truth() is None
    assert load_vehicle(tmp_path / "out.yaml").start.method == "in_flight"
    assert "nothing can be evaluated" in capsys.readouterr().out


def test_calibration_files_that_are_not_there_or_too_little_are_named(
    tumvi: Path, tmp_path: Path, capsys: Capsys
) -> None:
    chain = tumvi / "dso" / "camchain.yaml"
    lacking = tmp_path / "imu.yaml"
    lacking.write_text((tumvi / "dso" / "imu_config.yaml").read_text())
    out = str(tmp_path / "out")
    assert main(["import", "tumvi", str(tumvi), out, "--calibration", str(lacking)]) == 2
    assert "two cameras with T_cam_imu" in capsys.readouterr().err
    chain.rename(tmp_path / "hidden")
    try:
        assert main(["import", "tumvi", str(tumvi), out]) == 2
    finally:
        (tmp_path / "hidden").rename(chain)
    assert "--calibration" in capsys.readouterr().err


@pytest.mark.slow
def test_a_kitti_sequence_with_its_raw_drive_comes_back(
    rectified: Flight, kitti: tuple[Path, Path], tmp_path: Path
) -> None:
    found = imported("kitti", kitti[0], "--oxts", kitti[1], out=tmp_path / "out")
    assert_same_rig(found.rig, rectified.vehicle.rig)
    assert_same_events(found, rectified)
    assert_true_motion(found, rectified, origin=rectified.start.T_map_body.t)


def test_a_kitti_sequence_alone_says_that_it_can_not_be_run_for_want_of_an_imu(
    rectified: Flight, kitti: tuple[Path, Path], tmp_path: Path, capsys: Capsys
) -> None:
    out = tmp_path / "out"
    assert main(["import", "kitti", str(kitti[0]), str(out)]) == 0
    said = capsys.readouterr().out
    assert "no IMU" in said
    assert "--oxts" in said
    assert "run it: uav-vslam run" not in said
    assert not (tmp_path / "out.yaml").exists()
    topics = topics_of([out])
    assert "/uav1/imu/data_raw" not in topics
    assert topics["/uav1/left/image_raw/compressed"].count == len(rectified.frames)
    assert topics["/uav1/ground_truth/odometry"].count == len(rectified.frames)
    assert main(["run", str(out), "--no-plots", "--results", str(tmp_path / "results")]) == 2
    assert "lacks /uav1/imu/data_raw" in capsys.readouterr().err


def test_without_an_imu_the_body_is_the_left_camera_in_axes_forward_left_up(
    kitti: tuple[Path, Path], tmp_path: Path
) -> None:
    flight = read_kitti(kitti[0]).flight
    np.testing.assert_array_equal(flight.rig.T_body_left.matrix, T_FLU_OPTICAL.matrix)
    np.testing.assert_allclose(T_FLU_OPTICAL.apply([0.0, 0.0, 1.0]), [1.0, 0.0, 0.0])  # the optical axis is forward
    np.testing.assert_allclose(T_FLU_OPTICAL.apply([0.0, 1.0, 0.0]), [0.0, 0.0, -1.0])  # the image's lower edge is down
    first = next(iter(flight.truth)).T_world_body
    np.testing.assert_allclose(first.matrix, Pose.identity().matrix, atol=1e-12)


def test_the_colour_cameras_are_placed_by_their_projection_matrices(
    rectified: Flight, kitti: tuple[Path, Path], tmp_path: Path
) -> None:
    copy = tmp_path / "sequences" / "03"
    copy.mkdir(parents=True)
    for name in ("calib.txt", "times.txt"):
        (copy / name).write_text((kitti[0] / name).read_text())
    (copy / "image_2").symlink_to(kitti[0] / "image_0")
    (copy / "image_3").symlink_to(kitti[0] / "image_1")
    text = (copy / "calib.txt").read_text().splitlines()
    K = rectified.vehicle.rig.left.K
    P2 = np.column_stack([K, K @ [0.06, 0.001, 0.003]])
    text[2] = "P2: " + " ".join(map(repr, P2.ravel().tolist()))
    (copy / "calib.txt").write_text("\n".join(text) + "\n")
    rig = read_kitti(copy).flight.rig
    np.testing.assert_allclose((T_FLU_OPTICAL.inverse() @ rig.T_body_left).t, [-0.06, -0.001, -0.003], atol=1e-12)


def test_a_raw_drive_of_another_sequence_or_place_is_refused(
    kitti: tuple[Path, Path], tmp_path: Path, capsys: Capsys
) -> None:
    sequence, oxts = kitti
    times = (oxts.parent / "image_00" / "timestamps.txt").read_text().splitlines()
    other = tmp_path / "timestamps.txt"
    other.write_text("\n".join([times[0], *times]))  # one picture earlier: all others are late
    arguments = ["import", "kitti", str(sequence), str(tmp_path / "out"), "--oxts", str(oxts), "--image-times"]
    assert main([*arguments, str(other)]) == 2
    assert "--first-frame" in capsys.readouterr().err
    assert main([*arguments, str(other), "--first-frame", "1"]) == 0
    other.write_text("\n".join(times[:-1]))
    assert main([*arguments[:3], str(tmp_path / "short"), *arguments[4:], str(other)]) == 2
    assert "23 pictures" in capsys.readouterr().err


def test_kittis_first_readable_picture_gives_the_size(rectified: Flight, tmp_path: Path, capsys: Capsys) -> None:
    sequence, oxts = write_kitti(rectified, tmp_path / "kitti")
    (sequence / "image_0" / "000000.png").write_bytes(b"cut short")
    found = imported("kitti", sequence, "--oxts", oxts, out=tmp_path / "out")
    assert "000000.png: can't be decoded" in capsys.readouterr().err
    assert found.frame_count == len(rectified.frames) - 1


def test_a_missing_picture_and_a_broken_row_of_kitti_are_told(
    rectified: Flight, tmp_path: Path, capsys: Capsys
) -> None:
    sequence, oxts = write_kitti(rectified, tmp_path / "kitti")
    (sequence / "image_1" / "000005.png").unlink()
    (oxts / "data" / "0000000007.txt").write_text("1 2 3")
    found = imported("kitti", sequence, "--oxts", oxts, out=tmp_path / "out")
    said = capsys.readouterr()
    assert "times.txt:6: picture" in said.err
    assert "timestamps.txt:8: 0000000007.txt: 3 numbers, not 20" in said.err
    assert found.frame_count == len(rectified.frames) - 1


def test_images_of_tumvi_without_readings_are_left_out(fisheye: Flight, tmp_path: Path) -> None:
    folder = write_tumvi(fisheye, tmp_path / "tumvi")
    path = folder / "mav0" / "imu0" / "data.csv"
    lines = path.read_text().splitlines()
    path.write_text("\n".join(lines[: len(lines) // 2]))
    source = read_tumvi(folder)
    assert 0 < source.frame_count < len(fisheye.frames)
    left_out = len(fisheye.frames) - source.frame_count
    assert f"{left_out} image pairs before or after the IMU's readings are left out" in source.notes


def test_pictures_of_kitti_beyond_its_times_are_counted(rectified: Flight, tmp_path: Path, capsys: Capsys) -> None:
    sequence, _ = write_kitti(rectified, tmp_path / "kitti")
    path = sequence / "times.txt"
    path.write_text("".join(path.read_text().splitlines(keepends=True)[:-3]))
    assert main(["import", "kitti", str(sequence), str(tmp_path / "out")]) == 0
    assert "warning: 6 pictures are beyond the 21 lines of times.txt, and left out" in capsys.readouterr().err


def test_poses_of_kitti_that_are_fewer_than_its_pictures_are_told(
    rectified: Flight, tmp_path: Path, capsys: Capsys
) -> None:
    sequence, _ = write_kitti(rectified, tmp_path / "kitti")
    path = sequence.parents[1] / "poses" / f"{sequence.name}.txt"
    lines = path.read_text().splitlines(keepends=True)
    path.write_text("".join(lines[:5] + lines[6:]))  # nothing tells that the sixth is missing
    assert main(["import", "kitti", str(sequence), str(tmp_path / "out")]) == 0
    assert f"{path} has 23 rows for 24 pictures" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("file", "old", "new", "message"),
    [
        ("calib.txt", r"P0: \S+", "P0: 0.0", "calib.txt: P0 is no K [I | t] with focal lengths above 0"),
        ("calib.txt", r"Tr: \S+", "Tr: 0.5", "calib.txt: Tr is no rotation and translation"),
        ("times.txt", r"\n\S+\n$", "\n1e300\n", "times.txt:24: '1e300' is no time"),
        ("times.txt", r"\n\S+\n$", "\n3e9\n", "times.txt:24: '3e9' is no time"),
    ],
)
def test_what_is_wrong_in_a_kitti_sequence_is_one_line(
    file: str, old: str, new: str, message: str, rectified: Flight, tmp_path: Path, capsys: Capsys
) -> None:
    sequence, _ = write_kitti(rectified, tmp_path / "kitti")
    path = sequence / file
    path.write_text(re.sub(old, new, path.read_text()))
    assert main(["import", "kitti", str(sequence), str(tmp_path / "out")]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1


def test_a_raw_drive_of_a_single_reading_is_refused(rectified: Flight, tmp_path: Path, capsys: Capsys) -> None:
    sequence, oxts = write_kitti(rectified, tmp_path / "kitti")
    (oxts / "timestamps.txt").write_text((oxts / "timestamps.txt").read_text().splitlines()[0] + "\n")
    assert main(["import", "kitti", str(sequence), str(tmp_path / "out"), "--oxts", str(oxts)]) == 2
    error = capsys.readouterr().err
    assert "a single reading" in error
    assert error.count("\n") == 1


def test_a_place_of_the_imu_that_is_no_rotation_is_refused(rectified: Flight, tmp_path: Path, capsys: Capsys) -> None:
    sequence, oxts = write_kitti(rectified, tmp_path / "kitti")
    (oxts.parents[1] / "calib_imu_to_velo.txt").write_text("R: 1 0 0 0 1 0 0 0 0.9\nT: -0.8 0.3 -0.8\n")
    assert main(["import", "kitti", str(sequence), str(tmp_path / "out"), "--oxts", str(oxts)]) == 2
    assert "calib_imu_to_velo.txt: R and T is no rotation" in capsys.readouterr().err


def test_poses_of_kitti_that_are_no_rotation_are_left_out(rectified: Flight, tmp_path: Path) -> None:
    sequence, _ = write_kitti(rectified, tmp_path / "kitti")
    path = sequence.parents[1] / "poses" / "03.txt"
    lines = path.read_text().splitlines()
    lines[3], lines[5] = "1 0 0 0 0 1 0 0 0 0 2 0", "0 1 0 0 1 0 0 0 0 0 1 0"  # a scale, and a reflection
    path.write_text("\n".join(lines))
    problems = Problems()
    assert len(list(read_kitti(sequence, problems=problems).flight.truth)) == len(lines) - 2
    assert [text.split(": ")[0] for text in problems.lines] == [f"{path}:4", f"{path}:6"]


def ate_m(bag: Path, config: Path, results: Path) -> float:
    options = ["--no-plots", "--no-maps", "--no-smoothing", "--results", str(results)]
    assert main(["run", str(bag), "--config", str(config), *options]) == 0
    summary = json.loads((results / "latest" / "summary.json").read_text())
    return float(summary["vehicles"]["uav1"]["s_slam"]["ate_m"])


@pytest.mark.slow
@pytest.mark.parametrize("name", ["tumvi", "kitti"])
def test_an_imported_flight_runs_as_the_direct_bag(name: str, request: pytest.FixtureRequest, tmp_path: Path) -> None:
    source = request.getfixturevalue(name)
    flight = request.getfixturevalue({"tumvi": "fisheye", "kitti": "rectified"}[name])
    options = [] if name == "tumvi" else ["--oxts", source[1]]
    found = imported(name, source if name == "tumvi" else source[0], *options, out=tmp_path / "out")
    origin = None if name == "tumvi" else flight.start.T_map_body.t
    assert found.initial_state is not None
    direct = write_direct(flight, tmp_path / "bag", covariance=found.initial_state.covariance, origin=origin)
    config = tmp_path / "out.yaml"
    ours, expected = (ate_m(bag, config, tmp_path / f"{bag.name}_results") for bag in (tmp_path / "out", direct))
    assert ours == pytest.approx(expected, rel=0.05)
