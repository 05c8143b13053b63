# SPDX-License-Identifier: Apache-2.0
"""What all imports share: nothing is left out silently, and OUT is a whole recording or does not exist."""

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from uav_vslam.cli.main import main
from uav_vslam.config import find_config, load_vehicle
from uav_vslam.datasets.bag import open_flight
from uav_vslam.datasets.importing.euroc import read_euroc
from uav_vslam.datasets.importing.motion import InitialSigma, motion_of_poses
from uav_vslam.datasets.importing.pictures import Picture, frames, paired, shifted
from uav_vslam.datasets.importing.problems import SHOWN, Problems
from uav_vslam.datasets.importing.tables import read_table
from uav_vslam.datasets.message_builders import compressed_image_message
from uav_vslam.datasets.messages import image_of
from uav_vslam.errors import BagError
from uav_vslam.geometry.camera import PinholeCamera
from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.stereo import StereoRig
from uav_vslam.types import ImuSample, StereoFrame

IMU = [f"{ms * 1_000_000},0.01,0.0,0.0,0.0,0.0,9.81" for ms in range(0, 400, 5)]
SENSOR = """T_BS: {{data: [1.0, 0.0, 0.0, {x}, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0]}}
resolution: [64, 48]
intrinsics: [50.0, 51.0, 32.0, 24.0]
distortion_coefficients: [0.0, 0.0, 0.0, 0.0]
"""


@pytest.fixture
def mav0(tmp_path: Path) -> Path:
    """A small ASL folder: five pairs, 50 ms apart."""
    folder = tmp_path / "mav0"
    stamps = [ms * 1_000_000 for ms in range(100, 350, 50)]
    for k in (0, 1):
        camera = folder / f"cam{k}"
        (camera / "data").mkdir(parents=True)
        (camera / "sensor.yaml").write_text(SENSOR.format(x=0.1 * k))
        (camera / "data.csv").write_text("\n".join(["#t,file", *(f"{s},{s}.png" for s in stamps)]) + "\n")
        for s in stamps:
            cv2.imwrite(str(camera / "data" / f"{s}.png"), np.full((48, 64), s % 251 + k, np.uint8))
    for name, rows in (("imu0", IMU), ("state_groundtruth_estimate0", truth_rows())):
        (folder / name).mkdir()
        (folder / name / "data.csv").write_text("\n".join(["#header", *rows]) + "\n")
    return folder


def rig_of(width: int, height: int) -> StereoRig:
    camera = PinholeCamera(width, height, 50.0, 50.0, 32.0, 24.0)
    return StereoRig(camera, camera, Pose.identity(), Pose(np.eye(3), np.array([0.1, 0.0, 0.0])))


def truth_rows() -> list[str]:
    return [f"{ms * 1_000_000},{ms},2,3,1,0,0,0,4,5,6,0,0,0,0,0,0" for ms in range(0, 400, 20)]


def test_what_can_not_be_read_is_named_with_its_line_counted_and_listed(
    mav0: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (mav0 / "cam0" / "data" / "150000000.png").unlink()
    (mav0 / "cam1" / "data" / "200000000.png").write_bytes(b"")
    (mav0 / "imu0" / "data.csv").write_text("\n".join([*IMU[:3], "15000000,nan,0,0,0,0,9.81", "x", *IMU[4:]]))
    out = tmp_path / "out"
    assert main(["import", "euroc", str(mav0), str(out)]) == 0
    listed = (tmp_path / "out.warnings.txt").read_text().splitlines()
    for line in (f"{mav0}/imu0/data.csv:4:", f"{mav0}/imu0/data.csv:5:", f"{mav0}/cam0/data.csv:3:"):
        assert sum(line in text for text in listed) == 1
    assert sum("200000000.png is empty" in text for text in listed) == 1
    said = capsys.readouterr()
    assert all(line in said.err for line in listed)
    assert "2 lines that can't be read, 2 missing or broken pictures, 2 pictures without a partner" in said.out
    events = list(open_flight(out, "uav1").iter_events())
    assert [e.stamp_ns for e in events if isinstance(e, StereoFrame)] == [100_000_000, 250_000_000, 300_000_000]
    assert sum(isinstance(e, ImuSample) for e in events) == len(IMU) - 1


def test_thousands_of_equal_problems_are_counted_not_printed(tmp_path: Path) -> None:
    said: list[str] = []
    problems = Problems(said.append)
    for line in range(1, 1001):
        problems.add("lines that can't be read", tmp_path / "log", "broken", line=line)
    assert len(said) == SHOWN + 1
    assert problems.summary() == "1000 lines that can't be read"
    assert problems.lines[999] == f"{tmp_path / 'log'}:1000: broken"


def test_the_zeros_that_a_loss_of_power_leaves_are_not_printed(tmp_path: Path) -> None:
    path = tmp_path / "data.csv"
    path.write_bytes(b"10,1\n20,2\n30," + bytes(4096))
    problems = Problems()
    assert read_table(path, 1, problems).stamps_ns.tolist() == [10, 20]
    (line,) = problems.lines
    assert line.startswith(f"{path}:3: ")
    assert line.isprintable()
    assert len(line) < 320 + len(str(path))


def test_rows_out_of_order_are_sorted_in_and_told(tmp_path: Path) -> None:
    path = tmp_path / "data.csv"
    path.write_text("30,3\n10,1\n20,2\n20,9\n40,4\n")
    problems = Problems()
    table = read_table(path, 1, problems)
    np.testing.assert_array_equal(table.stamps_ns, [10, 20, 30, 40])
    np.testing.assert_array_equal(table.values[:, 0], [1, 2, 3, 4])
    assert [text.split(": ")[0].removeprefix(f"{path}:") for text in problems.lines] == ["2", "3", "4"]
    assert problems.summary() == "1 lines that repeat a stamp"
    assert problems.repaired_summary() == "2 lines out of order"


def test_what_is_sorted_in_is_not_counted_as_left_out(
    mav0: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (mav0 / "imu0" / "data.csv").write_text("\n".join([IMU[1], IMU[0], *IMU[2:]]))
    assert main(["import", "euroc", str(mav0), str(tmp_path / "out")]) == 0
    said = capsys.readouterr().out
    assert f"sorted in: 1 lines out of order; listed in {tmp_path / 'out.warnings.txt'}" in said
    assert "left out" not in said


def test_a_byte_order_mark_is_no_part_of_the_first_line(tmp_path: Path) -> None:
    path = tmp_path / "data.csv"
    path.write_bytes(b"\xef\xbb\xbf#stamp,value\n10,1\n")
    problems = Problems()
    assert len(read_table(path, 1, problems)) == 1
    assert problems.lines == []


@pytest.mark.parametrize("stamp", ["-5", str(2**31 * 1_000_000_000), "1" + "0" * 400])
def test_lines_whose_stamps_ros_can_not_hold_are_left_out(
    stamp: str, mav0: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name, values in (("imu0", "0,0,0,0,0,9.81"), ("state_groundtruth_estimate0", "1,2,3,1,0,0,0" + ",0" * 9)):
        with (mav0 / name / "data.csv").open("a") as stream:
            stream.write(f"{stamp},{values}\n")
    with (mav0 / "cam0" / "data.csv").open("a") as stream:
        stream.write(f"{stamp},350000000.png\n")
    assert main(["import", "euroc", str(mav0), str(tmp_path / "out")]) == 0
    said = capsys.readouterr()
    assert "left out: 3 lines that can't be read;" in said.out
    assert said.err.count("the stamp is not within 0 and 2^31 s") == 3
    assert open_flight(tmp_path / "out", "uav1").frame_count == 5


def test_further_columns_and_quotes_of_a_list_are_no_part_of_a_name(mav0: Path) -> None:
    path = mav0 / "cam1" / "data.csv"
    path.write_text("".join(f'{s},"{s}.png",,1\n' for s in range(100_000_000, 350_000_000, 50_000_000)))
    assert read_euroc(mav0).frame_count == 5


@pytest.mark.parametrize("stamp", ["1403715273262142976.0", "1.403715273262142976e+18", "1403715273.262142976", ""])
def test_stamps_that_are_no_whole_nanoseconds_are_left_out(stamp: str, tmp_path: Path) -> None:
    path = tmp_path / "data.csv"
    path.write_text(f"{stamp},1\n20,2\n")
    problems = Problems()
    assert read_table(path, 1, problems).stamps_ns.tolist() == [20]
    assert f"the stamp {stamp!r} is no whole number of nanoseconds" in problems.lines[0]


def test_readings_stamped_in_microseconds_are_refused(
    mav0: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = mav0 / "imu0" / "data.csv"
    rows = (row.split(",", 1) for row in path.read_text().splitlines() if not row.startswith("#"))
    path.write_text("".join(f"{int(stamp) // 1000},{rest}\n" for stamp, rest in rows))
    assert main(["import", "euroc", str(mav0), str(tmp_path / "out")]) == 2
    assert f"{path}: 200000 readings a second, which no IMU gives; check the unit" in capsys.readouterr().err


def test_truth_whose_quaternion_is_none_is_left_out_and_rounding_is_not(mav0: Path, tmp_path: Path) -> None:
    path = mav0 / "state_groundtruth_estimate0" / "data.csv"
    rows = truth_rows()
    for k, quaternion in enumerate(("0,0,0,0", "0.5,0.5,0.5,0.3", "0.71,0,0,0.71"), 12):
        rows[k] = rows[k].replace(",1,0,0,0,4", f",{quaternion},4")
    path.write_text("\n".join(rows))
    problems = Problems()
    truth = list(read_euroc(mav0, problems=problems).flight.truth)
    assert len(truth) == len(rows) - 2
    assert [text.split(": ")[0] for text in problems.lines] == [f"{path}:13", f"{path}:14"]
    assert "the quaternion's norm is 0, not 1" in problems.lines[0]
    np.testing.assert_allclose(truth[12].T_world_body.R @ truth[12].T_world_body.R.T, np.eye(3), atol=1e-12)


def test_pictures_pair_with_the_nearest_within_the_tolerance() -> None:
    def side(*stamps: int) -> list[Picture]:
        return [Picture(stamp, Path(f"{stamp}.png")) for stamp in stamps]

    problems = Problems()
    pairs = paired(side(0, 100, 200, 300), side(3, 98, 106, 215, 301), problems, tolerance_ns=10)
    assert [(pair.left.stamp_ns, pair.right.stamp_ns) for pair in pairs] == [(0, 3), (100, 98), (300, 301)]
    assert problems.counts == {"pictures without a partner": 3}
    assert paired([], side(1), problems, tolerance_ns=10) == []
    (contested,) = paired(side(0, 4), side(3), Problems(), tolerance_ns=10)  # no picture is used twice
    assert contested.left.stamp_ns == 4


@pytest.mark.parametrize(("suffix", "copied"), [(".png", True), (".jpg", True), (".pgm", False), (".tiff", False)])
def test_files_that_ros_knows_are_copied_and_others_keep_their_pixels(
    suffix: str, copied: bool, tmp_path: Path
) -> None:
    path = tmp_path / f"picture{suffix}"
    pixels = np.arange(48 * 64, dtype=np.uint8).reshape(48, 64)
    cv2.imwrite(str(path), pixels)
    picture = Picture(7, path)
    (frame,) = frames(shifted(paired([picture], [picture], Problems()), 5), rig_of(64, 48), Problems())
    assert frame.stamp_ns == 12
    if copied:
        assert frame.left.content == path.read_bytes()
    else:
        np.testing.assert_array_equal(frame.left.content, pixels)


@pytest.mark.parametrize("name", ["picture.pgm", "picture.jpg", "picture.PNG"])
def test_a_picture_that_turns_out_to_be_none_is_left_out(name: str, tmp_path: Path) -> None:
    path = tmp_path / name
    path.write_bytes(b"P5 no more")
    problems = Problems()
    picture = Picture(7, path)
    assert list(frames(paired([picture], [picture], problems), rig_of(64, 48), problems)) == []
    assert problems.counts == {"missing or broken pictures": 2}
    assert problems.lines[0] == f"{path}: can't be decoded"


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".pgm"])
@pytest.mark.parametrize("size", [(64, 48), (63, 47)])
def test_a_picture_of_another_size_than_calibrated_is_left_out(
    size: tuple[int, int], suffix: str, tmp_path: Path
) -> None:
    pictures = [Picture(k, tmp_path / f"{k}{suffix}") for k in range(3)]
    for picture, (width, height) in zip(pictures, [(32, 24), size, (64, 24)], strict=True):
        cv2.imwrite(str(picture.path), np.zeros((height, width), np.uint8))
    problems = Problems()
    kept = list(frames(paired(pictures, pictures, problems), rig_of(*size), problems))
    assert [frame.stamp_ns for frame in kept] == [1]
    assert problems.counts == {"pictures of another size than calibrated": 4}
    assert f"32x24 px, but the calibration of {size[0]}x{size[1]} px" in problems.lines[0]


def test_links_that_lead_nowhere_are_missing_pictures(mav0: Path, tmp_path: Path) -> None:
    picture = mav0 / "cam0" / "data" / "200000000.png"
    picture.unlink()
    picture.symlink_to("annex/of/a/clone/without/data")
    assert main(["import", "euroc", str(mav0), str(tmp_path / "out")]) == 0
    assert open_flight(tmp_path / "out", "uav1").frame_count == 4


def test_a_list_without_names_makes_no_recording(
    mav0: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    listed = mav0 / "cam0" / "data.csv"
    listed.write_text("\n".join(line.partition(",")[0] for line in listed.read_text().splitlines()))
    assert main(["import", "euroc", str(mav0), str(tmp_path / "out")]) == 2
    assert f"{listed}:2: '100000000' is not 'stamp,filename'" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["mav0"]


def test_a_data_set_whose_pictures_are_all_broken_makes_no_recording(
    mav0: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for path in (mav0 / "cam1" / "data").iterdir():
        path.write_bytes(path.read_bytes()[:20])
    assert main(["import", "euroc", str(mav0), str(tmp_path / "out")]) == 2
    assert "none of 5 image pairs can be read" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["mav0"]


def test_only_pairs_that_were_written_are_counted(
    mav0: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (mav0 / "cam0" / "data" / "200000000.pgm").write_bytes(b"P5 no more")
    listed = mav0 / "cam0" / "data.csv"
    listed.write_text(listed.read_text().replace("200000000.png", "200000000.pgm"))
    assert main(["import", "euroc", str(mav0), str(tmp_path / "out")]) == 0
    assert f"{tmp_path / 'out'}: 4 image pairs of uav1" in capsys.readouterr().out
    assert open_flight(tmp_path / "out", "uav1").frame_count == 4


@pytest.mark.parametrize("pattern", ["rggb", "bggr", "gbrg", "grbg"])
def test_a_compressed_bayer_mosaic_is_read_as_colour(pattern: str) -> None:
    at = {"r": 200, "g": 90, "b": 40}
    tile = np.array([at[letter] for letter in pattern], np.uint8).reshape(2, 2)
    _, png = cv2.imencode(".png", np.tile(tile, (8, 8)))
    message = compressed_image_message(1, "left", bytes(png), fmt=f"bayer_{pattern}8; png compressed")
    np.testing.assert_array_equal(image_of(message)[8, 8], [40, 90, 200])


def test_velocities_are_those_of_the_positions_whatever_the_sign_of_the_quaternions() -> None:
    stamps = np.arange(0, 1_000_000_000, 10_000_000)
    seconds = stamps / 1e9
    positions = np.column_stack([3.0 * seconds, np.zeros_like(seconds), 0.5 * seconds])
    quaternions = np.tile([0.6, 0.0, 0.0, 0.8], (len(stamps), 1)) * np.where(np.arange(len(stamps)) % 2, 1, -1)[:, None]
    motion = motion_of_poses(stamps, positions, quaternions, source=Path("poses"))
    np.testing.assert_allclose(motion.table.values[:, 7:10], np.tile([3.0, 0.0, 0.5], (len(stamps), 1)), atol=1e-12)
    parabola = np.column_stack([seconds**2, -3.0 * seconds**2, seconds])
    motion = motion_of_poses(stamps, parabola, quaternions, source=Path("poses"))
    expected = np.column_stack([2.0 * seconds, -6.0 * seconds, np.ones_like(seconds)])  # exact, at the ends too
    np.testing.assert_allclose(motion.table.values[:, 7:10], expected, atol=1e-12)
    between = motion.table.at(np.array([505_000_000]))[0, 3:7]
    np.testing.assert_allclose(np.abs(between), [0.6, 0.0, 0.0, 0.8], atol=1e-12)


@pytest.mark.parametrize("stamps_ms", [[0, 10, 20, 30, 40, 300], [0, 260, 270, 280, 290, 300], [0, 200, 210, 900]])
def test_velocities_next_to_a_gap_are_those_of_the_positions(stamps_ms: list[int]) -> None:
    stamps_ns = np.array(stamps_ms) * 1_000_000
    velocity = np.array([3.0, -2.0, 0.5])
    poses = velocity * stamps_ns[:, None] * 1e-9, np.tile([1.0, 0.0, 0.0, 0.0], (len(stamps_ms), 1))
    motion = motion_of_poses(stamps_ns, *poses, source=Path("gap"))
    np.testing.assert_allclose(motion.table.values[:, 7:10], np.tile(velocity, (len(stamps_ms), 1)), atol=1e-9)


def test_a_start_between_quaternions_of_opposite_sign_has_their_attitude(mav0: Path) -> None:
    turned = [(row, "0.6,0,0,0.8" if k < 5 else "-0.6,0,0,-0.8") for k, row in enumerate(truth_rows()) if k != 5]
    rows = [row.replace(",1,0,0,0,4", f",{q},4") for row, q in turned]  # none at the first pair, 100 ms
    (mav0 / "state_groundtruth_estimate0" / "data.csv").write_text("\n".join(rows))
    flight = read_euroc(mav0).flight
    assert flight.initial is not None
    expected = Pose.from_quaternion_wxyz(np.array([0.6, 0.0, 0.0, 0.8]), np.zeros(3)).R
    np.testing.assert_allclose(flight.initial.state.T_map_body.R, expected, atol=1e-12)


def test_keyframes_far_apart_are_not_tracked(mav0: Path, tmp_path: Path) -> None:
    for cam in ("cam0", "cam1"):
        listed = (mav0 / cam / "data.csv").read_text().splitlines()
        (mav0 / cam / "data.csv").write_text("\n".join([listed[0], listed[1], listed[-1]]) + "\n")
    assert main(["import", "euroc", str(mav0), str(tmp_path / "out")]) == 0
    config = load_vehicle(tmp_path / "out.yaml")
    assert config == load_vehicle(find_config("euroc"))
    assert config.frontend.method == "sift"


@pytest.mark.data
@pytest.mark.parametrize("name", ["euroc", "euroc_video"])
def test_the_configured_sigmas_allow_for_the_biases_of_eurocs_imu(data_root: Path, name: str) -> None:
    mav0, imu = data_root / "euroc_v101_keyframes" / "mav0", load_vehicle(find_config(name)).imu
    rows = np.loadtxt(mav0 / "state_groundtruth_estimate0" / "data.csv", delimiter=",")
    assert np.abs(rows[:, 11:14]).max() < 2.0 * imu.gyro_bias_sigma
    assert np.abs(rows[:, 14:17]).max() < 2.0 * imu.accel_bias_sigma


def test_the_written_configuration_is_the_formats_and_one_that_is_there_is_kept(
    mav0: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["import", "euroc", str(mav0), str(tmp_path / "out")]) == 0
    assert load_vehicle(tmp_path / "out.yaml") == load_vehicle(find_config("euroc_video"))
    (tmp_path / "mine.yaml").write_text("# mine\n")
    capsys.readouterr()
    assert main(["import", "euroc", str(mav0), str(tmp_path / "mine")]) == 0
    assert (tmp_path / "mine.yaml").read_text() == "# mine\n"
    assert f"{tmp_path / 'mine.yaml'} was there already and is kept" in capsys.readouterr().out


def test_a_folder_in_place_of_the_configuration_is_refused_before_the_data_set_is_read(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "out.yaml").mkdir()
    assert main(["import", "euroc", str(tmp_path / "nowhere"), str(tmp_path / "out")]) == 2
    assert f"{tmp_path / 'out.yaml'}: is no file" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["out.yaml"]


def test_an_import_that_was_cut_short_starts_again(
    mav0: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    left = tmp_path / "out.partial" / "out"
    left.mkdir(parents=True)
    (left / "out.mcap").write_bytes(b"begun")
    assert main(["import", "euroc", str(mav0), str(tmp_path / "out")]) == 0
    assert "cut short, is removed" in capsys.readouterr().err
    assert not (tmp_path / "out.partial").exists()
    assert open_flight(tmp_path / "out", "uav1").frame_count == 5


def test_an_import_that_fails_leaves_nothing(
    mav0: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    read_bytes: Callable[[Path], bytes] = Path.read_bytes

    def interrupted(path: Path) -> bytes:
        if path.name == "250000000.png":
            raise KeyboardInterrupt
        return read_bytes(path)

    monkeypatch.setattr(Path, "read_bytes", interrupted)
    assert main(["import", "euroc", str(mav0), str(tmp_path / "out")]) == 130
    assert sorted(path.name for path in tmp_path.iterdir()) == ["mav0"]


def test_a_finished_import_and_other_peoples_folders_are_not_overwritten(
    mav0: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["import", "euroc", str(mav0), str(tmp_path / "out")]) == 0
    assert main(["import", "euroc", str(mav0), str(tmp_path / "out")]) == 2
    assert "exists already" in capsys.readouterr().err
    (tmp_path / "new.partial").mkdir()
    (tmp_path / "new.partial" / "thesis.txt").write_text("years of work")
    assert main(["import", "euroc", str(mav0), str(tmp_path / "new")]) == 2
    assert (tmp_path / "new.partial" / "thesis.txt").exists()


def test_a_start_on_a_row_of_the_ground_truth_may_follow_a_gap() -> None:
    stamps = np.array([0, 1_000_000_000, 1_010_000_000])
    motion = motion_of_poses(stamps, np.eye(3), np.tile([1.0, 0.0, 0.0, 0.0], (3, 1)), source=Path("poses"))
    np.testing.assert_array_equal(motion.start(1_000_000_000, InitialSigma()).state.T_map_body.t, [0.0, 1.0, 0.0])
    with pytest.raises(BagError, match="gap at the first image"):
        motion.start(999_999_999, InitialSigma())


def test_a_gap_of_the_ground_truth_at_the_start_is_refused(mav0: Path) -> None:
    rows = [row for row in truth_rows() if not 20_000_000 <= int(row.split(",")[0]) <= 140_000_000]
    (mav0 / "state_groundtruth_estimate0" / "data.csv").write_text("\n".join(rows))
    with pytest.raises(BagError, match=r"state_groundtruth.*gap at the first image"):
        read_euroc(mav0)
