# SPDX-License-Identifier: Apache-2.0
"""`study euroc` takes a bag or an ASL folder, and says what it can't use."""

import json
import re
from pathlib import Path

import cv2
import numpy as np
import pytest

from uav_vslam.cli.main import main
from uav_vslam.simulation.recording import record
from uav_vslam.simulation.scenario import Scenario

FRAMES = 8
STARTS = ["recorded", "drawn 1", "frame 2", "frame 4", "frame 6"]
SENSOR = """%YAML:1.0
T_BS: {{cols: 4, rows: 4, data: [1, 0, 0, {x}, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]}}
resolution: [160, 120]
intrinsics: [100.0, 100.0, 80.0, 60.0]
distortion_coefficients: [0.0, 0.0, 0.0, 0.0]
"""


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("bags") / "tiny"
    record(Scenario(frames=FRAMES, vehicles=1, scale=0.125), path)
    return path


@pytest.fixture(scope="module")
def mav0(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A vehicle at rest before a wall of noise, as an ASL folder."""
    folder = tmp_path_factory.mktemp("asl") / "mav0"
    wall = cv2.GaussianBlur(np.random.default_rng(1).uniform(0, 255, (120, 180)), (0, 0), 1.5)
    wall = cv2.normalize(wall, None, 0, 255, cv2.NORM_MINMAX).astype(np.uint8)
    stamps = [k * 200_000_000 for k in range(1, FRAMES + 1)]
    for camera, x, view in (("cam0", 0.0, wall[:, 10:170]), ("cam1", 0.1, wall[:, 15:175])):
        (folder / camera / "data").mkdir(parents=True)
        (folder / camera / "sensor.yaml").write_text(SENSOR.format(x=x))
        (folder / camera / "data.csv").write_text("".join(f"{s},{s}.png\n" for s in stamps))
        for stamp in stamps:
            noise = np.random.default_rng([stamp, int(camera[-1])]).normal(0, 1, view.shape)  # no camera repeats itself
            image = np.clip(view + noise, 0, 255).astype(np.uint8)
            cv2.imwrite(str(folder / camera / "data" / f"{stamp}.png"), image)
    end = stamps[-1] + 100_000_000
    (folder / "imu0").mkdir()
    (folder / "imu0" / "data.csv").write_text("".join(f"{s},0,0,0,0,0,9.81\n" for s in range(0, end, 5_000_000)))
    (folder / "state_groundtruth_estimate0").mkdir()
    truth = "".join(f"{s},0,0,0,1,0,0,0,0,0,0,0,0,0,0,0,0\n" for s in range(0, end, 50_000_000))
    (folder / "state_groundtruth_estimate0" / "data.csv").write_text(truth)
    return folder


def study(recording: Path, results: Path, *options: str) -> dict[str, list[dict[str, object]]]:
    arguments = ["--filters", "eif", "--seeds", "1", "--workers", "1", "--results", str(results), *options]
    assert main(["study", "euroc", str(recording), *arguments]) == 0
    tree: dict[str, list[dict[str, object]]] = json.loads((results / "latest" / "study.json").read_text())
    return tree


def test_a_bag_is_flown_from_every_start_and_drawn(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    tree = study(bag, tmp_path, "--config", "kagaru")
    assert [row["condition"] for row in tree["rows"][1:]] == STARTS
    assert [row["frames"] for row in tree["rows"][1:]] == [FRAMES, FRAMES, 6, 4, 2]
    assert re.search(r"\| eif +\| recorded +\|", capsys.readouterr().out)
    picture = cv2.imread(str(tmp_path / "latest" / "errors.png"))
    assert picture.std() > 5


@pytest.mark.slow
def test_an_asl_folder_is_taken_as_it_is(mav0: Path, tmp_path: Path) -> None:
    tree = study(mav0, tmp_path)
    assert [row["condition"] for row in tree["rows"][1:]] == STARTS
    assert tree["rows"][0]["frames_coasted_worst"] == 0


def test_a_setting_reaches_the_runs(bag: Path, tmp_path: Path) -> None:
    untracked = "--set", "frontend.method=sift"  # tracks correct the state without landmarks
    blind = study(bag, tmp_path, "--config", "kagaru", *untracked, "--set", "backend.max_new_landmarks=0")
    assert blind["rows"][1]["frames_coasted"] == FRAMES - 1


def test_no_recording_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["study", "euroc", str(tmp_path / "nowhere")]) == 2
    error = capsys.readouterr().err
    assert "nowhere" in error
    assert error.count("\n") == 1
