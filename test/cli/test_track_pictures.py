# SPDX-License-Identifier: Apache-2.0
"""`run` draws tracks on the recorded images, and computes the same with pictures and without."""

import dataclasses
import json
from pathlib import Path

import cv2
import pytest

from uav_vslam.cli.main import main
from uav_vslam.datasets.bag import open_flight
from uav_vslam.datasets.flight_writer import ImageCoding
from uav_vslam.simulation.recording import record
from uav_vslam.simulation.scenario import SCENARIOS
from uav_vslam.types import StereoFrame

FRAMES = 9  # 1.1 s: two epochs


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("flight") / "bag"
    record(dataclasses.replace(SCENARIOS["sample"], frames=FRAMES, vehicles=1), path, coding=ImageCoding("png"))
    return path


def test_left_images_are_those_of_the_frames(bag: Path) -> None:
    flight = open_flight(bag, "uav1")
    frames = {event.stamp_ns: event.left for event in flight.iter_events() if isinstance(event, StereoFrame)}
    wanted = list(frames)[1::2]
    found = dict(flight.left_images(wanted))
    assert list(found) == wanted
    assert all((found[stamp_ns] == frames[stamp_ns]).all() for stamp_ns in wanted)


@pytest.mark.slow
def test_a_run_writes_sheet_and_video_and_the_same_trajectories_as_without(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = ["run", str(bag), "--config", "sample"]
    assert main([*run, "--results", str(tmp_path / "drawn"), "--sheet", "3", "--video"]) == 0
    assert main([*run, "--results", str(tmp_path / "plain"), "--no-plots"]) == 0
    drawn, plain = (tmp_path / name / "latest" for name in ("drawn", "plain"))
    for name in ("uav1_s_slam.tum", "uav1_ins.tum", "uav1_frames.csv"):
        assert (drawn / name).read_bytes() == (plain / name).read_bytes()
    assert not list(plain.glob("*.png")) + list(plain.glob("*.mp4"))
    assert {"quality.png", "landmarks.png", "uav1_tracks.png", "uav1_tracks.mp4"} <= {p.name for p in drawn.iterdir()}
    assert cv2.VideoCapture(str(drawn / "uav1_tracks.mp4")).get(cv2.CAP_PROP_FRAME_COUNT) == FRAMES
    quality = json.loads((plain / "summary.json").read_text())["vehicles"]["uav1"]["quality"]
    assert quality["frames_coasted"] == 0
    assert "coasted 0 of 9 frames" in capsys.readouterr().out
