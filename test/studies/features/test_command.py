# SPDX-License-Identifier: Apache-2.0
"""The study of features runs from the command line on whatever images it is given."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from uav_vslam.cli import main as command
from uav_vslam.evaluation.output import LATEST


def study(*arguments: str) -> int:
    return command.main(["study", "features", *arguments])


def rows_of(results: Path) -> list[dict]:
    return json.loads((results / LATEST / "study.json").read_text())["rows"]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Three images that overlap."""
    path = tmp_path / "flight"
    path.mkdir()
    noise = np.random.default_rng(1).normal(128, 40, (130, 200)).astype(np.float32)
    whole = np.clip(128 + 4 * (cv2.GaussianBlur(noise, (0, 0), 2.0) - 128), 0, 255).astype(np.uint8)
    for k in range(3):
        cv2.imwrite(str(path / f"{k}.png"), whole[:, 10 * k : 10 * k + 170])
    return path


@pytest.mark.slow
def test_a_folder_and_a_pair_leave_tables_and_pictures(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    results, pair = tmp_path / "results", f"{folder / '0.png'},{folder / '2.png'}"
    options = ["--algorithms", "SIFT", "ORB", "--seeds", "0", "--results", str(results)]
    assert study(str(folder), pair, *options) == 0
    assert {path.name for path in (results / LATEST).iterdir()} == {
        *("study.json", "study.md", "report.html", "matches"),
        *("places.png", "spacing.png", "thresholds.png"),
    }
    assert len(list((results / LATEST / "matches").iterdir())) == 2
    images = {row["condition"] for row in rows_of(results) if row["table"].startswith("Spacing")}
    assert images == {"flight images 0 – 1", "flight images 0 – 2"}
    assert "Trends of the thesis" in capsys.readouterr().out


@pytest.mark.parametrize("kind", ["noise", "blank"])
def test_images_that_do_not_match_leave_rows_without_matches(
    kind: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rng = np.random.default_rng(1)
    for name in "ab":
        image = rng.integers(0, 256, (120, 160)) if kind == "noise" else np.full((120, 160), 128)
        cv2.imwrite(str(tmp_path / f"{name}.png"), image.astype(np.uint8))
    pair = ",".join(str(tmp_path / f"{name}.png") for name in "ab")
    options = ["--algorithms", "SIFT", "SURF", "ORB", "--seeds", "0", "--results", str(tmp_path / "results")]
    assert study(pair, *options) == 0
    rows = rows_of(tmp_path / "results")
    sift = [row for row in rows if row["method"] == "SIFT" and row["descriptor_ratio"] < 0.9]
    assert sift
    assert all((row["matches"], row["matches_ransac"]) == (0, 0) for row in sift)
    assert all((row["keypoints_1"] > 0) == (kind == "noise") for row in sift)
    assert {path.name for path in (tmp_path / "results" / LATEST).glob("*.png")} == {
        *("places.png", "spacing.png", "thresholds.png"),
    }
    assert "too few images match" in capsys.readouterr().out


@pytest.mark.slow
@pytest.mark.data
def test_one_pair_of_the_thesiss_images(data_root: Path, tmp_path: Path) -> None:
    camp = data_root / "tno_nato_camp/visual"
    options = ["--algorithms", "SIFT", "SURF", "DSIFT", "--seeds", "0", "--results", str(tmp_path)]
    assert study(f"{camp / '1802v.bmp'},{camp / '1810v.bmp'}", *options) == 0
    found = {row["method"]: row for row in rows_of(tmp_path) if row["table"].startswith("Places")}
    assert (found["SIFT"]["keypoints_1"], found["SIFT"]["keypoints_2"]) == (279, 306)
    assert found["SURF"]["matches_ransac"] > 30
    assert found["DSIFT"]["matches_ransac"] > 1000


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["nowhere"], "nowhere is no folder, no pair A,B of files and none of tno_nato_camp"),
        (["a.png,b.png"], "a.png can't be read as an image"),
        (["tno_nato_camp"], "let UAV_VSLAM_DATA name the folder"),
        (["--algorithms", "SOFT"], "algorithm 'SOFT' is not known; use some of ASIFT, SURF"),
        (["--seeds", "0"], "there are no images"),
    ],
)
def test_wrong_images_are_one_line_and_exit_code_2(
    arguments: list[str], message: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.delenv("UAV_VSLAM_DATA", raising=False)
    assert study(*arguments) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
