# SPDX-License-Identifier: Apache-2.0
"""`uav-vslam calibrate` finds the cameras behind rendered pictures, and those behind real ones."""

import contextlib
import io
import json
from collections.abc import Callable
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest
from board_scene import poses, rendered_pair, rig_of

from uav_vslam.calibration.boards import Board, Charuco, Chessboard
from uav_vslam.cli.main import main
from uav_vslam.datasets.bag_recorder import RawRecorder
from uav_vslam.datasets.calibration_files import read_calibration
from uav_vslam.datasets.cdr import encode
from uav_vslam.datasets.message_builders import compressed_image_message

BOARDS: dict[str, tuple[Board, list[str]]] = {
    "chessboard": (Chessboard(8, 5, 0.03), ["--board", "8x5", "--square", "0.03"]),
    "charuco": (
        Charuco(6, 4, 0.03, 0.022, "DICT_4X4_50"),
        ["--board", "6x4", "--square", "0.03", "--charuco", "DICT_4X4_50", "--marker", "0.022"],
    ),
}
PAIRS = 12
BASELINE, FOCAL = 0.002, 0.002  # relative: five times the standard deviations with the ChArUco board


def pictures_of(board: Board, folder: Path) -> Path:
    rig = rig_of()
    for k, pose in enumerate(poses(board, rig, PAIRS, np.random.default_rng(11))):
        for side, image in zip(("left", "right"), rendered_pair(rig, board, pose), strict=True):
            cv2.imwrite(str(folder / f"{side}{k:02}.png"), image)
    return folder


@pytest.fixture(scope="module")
def rendered(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """What returns the folder with rendered pictures of a kind of board."""
    return cache(lambda kind: pictures_of(BOARDS[kind][0], tmp_path_factory.mktemp(kind)))


@pytest.fixture
def chessboard(rendered: Callable[[str], Path]) -> Path:
    """Rendered pictures of a chessboard."""
    return rendered("chessboard")


def recorded(folder: Path, bag: Path) -> Path:
    """Return a bag of a folder's pictures."""
    with RawRecorder(bag) as recorder:
        for k in range(PAIRS):
            for side in ("left", "right"):
                built = compressed_image_message(k, "", (folder / f"{side}{k:02}.png").read_bytes(), fmt="png")
                recorder.write(f"/uav3/{side}/image_raw/compressed", built.__msgtype__, encode(built), k)
    return bag


def refused(capsys: pytest.CaptureFixture[str], *arguments: str | Path) -> str:
    assert main(["calibrate", *map(str, arguments)]) == 2
    error = capsys.readouterr().err
    assert error.startswith("uav-vslam: ")
    assert error.count("\n") == 1, error
    return error


@pytest.fixture(scope="module")
def calibrated(
    rendered: Callable[[str], Path], tmp_path_factory: pytest.TempPathFactory
) -> Callable[[str], tuple[Path, str]]:
    """What returns the results from rendered pictures of a kind of board, and what was printed."""

    @cache
    def calibrate(kind: str) -> tuple[Path, str]:
        folder, results, printed = rendered(kind), tmp_path_factory.mktemp("results"), io.StringIO()
        patterns = [str(folder / "left*.png"), str(folder / "right*.png")]
        with contextlib.redirect_stdout(printed):
            assert main(["calibrate", *patterns, *BOARDS[kind][1], "--results", str(results)]) == 0
        return results / "latest", printed.getvalue()

    return calibrate


@pytest.mark.slow
@pytest.mark.parametrize("kind", BOARDS)
def test_rendered_pictures_give_the_cameras_that_took_them(
    kind: str, calibrated: Callable[[str], tuple[Path, str]]
) -> None:
    (latest, said), true = calibrated(kind), rig_of()
    assert {path.name for path in latest.iterdir()} == {
        "left.yaml",
        "right.yaml",
        "camchain.yaml",
        "summary.json",
        "calibration.png",
    }
    left, right = read_calibration([latest / "left.yaml", latest / "right.yaml"]).cameras
    assert left.camera.fx == pytest.approx(true.left.fx, rel=FOCAL)
    assert right.camera.fy == pytest.approx(true.right.fy, rel=FOCAL)
    assert right.T_left_cam is not None
    assert np.linalg.norm(right.T_left_cam.t) == pytest.approx(true.baseline_m, rel=BASELINE)
    summary = json.loads((latest / "summary.json").read_text())
    assert summary["pairs_used"] == PAIRS
    assert summary["reprojection_px"]["stereo"] < 0.15
    assert "use it:  input: {calibration: [" in said
    assert str(latest.resolve() / "left.yaml") in said


@pytest.mark.slow
def test_a_recording_of_the_pictures_gives_the_same_cameras(
    chessboard: Path, calibrated: Callable[[str], tuple[Path, str]], tmp_path: Path
) -> None:
    bag, results = recorded(chessboard, tmp_path / "bag"), tmp_path / "results"
    arguments = [str(bag), *BOARDS["chessboard"][1], "--results", str(results), "--no-plots"]
    assert main(["calibrate", *arguments]) == 0
    assert not (results / "latest" / "calibration.png").exists()
    expected, found = (
        json.loads((latest / "summary.json").read_text())["baseline_m"]
        for latest in (calibrated("chessboard")[0], results / "latest")
    )
    assert found == expected


@pytest.mark.slow
def test_pictures_that_can_not_be_read_are_left_out_and_told(
    chessboard: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for picture in chessboard.glob("*.png"):
        (tmp_path / picture.name).symlink_to(picture)
    (tmp_path / "right05.png").unlink()
    (tmp_path / "right05.png").write_bytes(b"no picture")
    options = [*BOARDS["chessboard"][1], "--results", str(tmp_path / "results"), "--no-plots"]
    assert main(["calibrate", str(tmp_path), *options]) == 0
    said = capsys.readouterr().out
    assert f"{PAIRS - 1} pairs used, 1 rejected" in said
    assert f"rejected 05: {tmp_path / 'right05.png'} can't be read as an image" in said


@pytest.mark.slow
def test_a_damaged_recording_is_calibrated_from_up_to_the_damage(
    chessboard: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (bag,) = recorded(chessboard, tmp_path / "bag").glob("*.mcap")
    cut, arguments = tmp_path / "cut.mcap", [*BOARDS["chessboard"][1], "--results", str(tmp_path), "--no-plots"]
    topics = ["--topics", "/uav3/left/image_raw", "/uav3/right/image_raw"]
    cut.write_bytes(bag.read_bytes()[: bag.stat().st_size * 5 // 6])
    assert main(["calibrate", str(cut), *topics, *arguments]) == 2
    said = capsys.readouterr()
    assert 8 <= json.loads((tmp_path / "latest" / "summary.json").read_text())["pairs_used"] < PAIRS
    assert said.err.startswith(f"uav-vslam: calibrated up to a break: bag {cut} is damaged")
    cut.write_bytes(bag.read_bytes()[: bag.stat().st_size // 2])
    line = refused(capsys, cut, *topics, *arguments)
    assert "8 are needed; take more pictures; bag" in line
    assert "cut.mcap is damaged" in line


@pytest.mark.slow
def test_a_wrong_board_is_told_with_the_right_one(
    chessboard: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for picture in chessboard.glob("*0[0-5].png"):
        (tmp_path / picture.name).symlink_to(picture)
    line = refused(capsys, tmp_path, "--board", "9x6", "--square", "0.03")
    assert "0 of 6 pairs show the 9x6 board" in line
    assert "use --board 8x5" in line


@pytest.mark.slow
@pytest.mark.parametrize("size", ["4x3", "5x3"])
def test_a_part_of_the_board_is_not_calibrated_by(
    size: str, chessboard: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    line = refused(capsys, chessboard, "--board", size, "--square", "0.03", "--results", tmp_path)
    assert f"a board of {size} inner corners is a part of the one seen" in line
    assert "use --board 8x5" in line


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--charuco", "DICT_4X4_50"], "--charuco needs --marker"),
        (["--marker", "0.02"], "name its dictionary by --charuco"),
        (["--model", "equidistant", "--fix", "p1"], "equidistant has no coefficient p1"),
        (["--most", "5"], "--topics and --most belong to a bag"),
        (["--topics", "/left", "/right"], "--topics and --most belong to a bag"),
    ],
)
def test_options_that_do_not_go_together_are_refused(
    options: list[str], said: str, chessboard: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert said in refused(capsys, chessboard, "--board", "8x5", "--square", "0.03", *options)


def test_a_folder_without_pictures_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert "holds 0 pictures" in refused(capsys, tmp_path, "--board", "8x5", "--square", "0.03")


@pytest.mark.slow
@pytest.mark.data
def test_real_pictures_are_calibrated_to_a_fifth_of_a_pixel_and_both_halves_agree(
    data_root: Path, tmp_path: Path
) -> None:
    pictures = data_root / "chessboard_stereo"
    assert main(["calibrate", str(pictures), "--board", "9x6", "--square", "1", "--results", str(tmp_path)]) == 0
    summary = json.loads((tmp_path / "latest" / "summary.json").read_text())
    assert summary["pairs_used"] == 25
    assert summary["reprojection_px"]["stereo"] <= 0.20
    assert summary["halves"]["baseline_difference"] < 0.01
    assert summary["warnings"] == []


def test_a_square_in_millimetres_is_noticed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    line = refused(capsys, tmp_path, "--board", "8x5", "--square", "30")
    assert "--square 30 is in metres; if millimetres, give 0.03" in line


@pytest.mark.parametrize("value", ["inf", "nan", "0", "-0.03", "wide"])
@pytest.mark.parametrize("option", ["--square", "--marker"])
def test_a_side_that_is_no_length_is_refused(
    option: str, value: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["calibrate", str(tmp_path), "--board", "8x5", f"{option}={value}"])
    assert ended.value.code == 2
    assert f"argument {option}: {value!r} is not a length in metres above 0" in capsys.readouterr().err
