# SPDX-License-Identifier: Apache-2.0
"""`uav-vslam cut` makes a bag that `run` takes as it is, and says what it did."""

import itertools
import json
import shlex
from pathlib import Path

import numpy as np
import pytest

from uav_vslam.cli.main import main
from uav_vslam.datasets.bag import open_flight
from uav_vslam.datasets.bag_recorder import RawRecorder
from uav_vslam.datasets.rosbag import iter_raw
from uav_vslam.evaluation.files.reading import read_trajectory
from uav_vslam.simulation.recording import record
from uav_vslam.simulation.scenario import Scenario

LEGS = ["--legs", "0-1.5,1.6-3.2"]
OFTEN = ["--set", "fusion.epoch_s=0.3"]  # several packets in a second and a half


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("source") / "flight"
    record(Scenario(frames=24, vehicles=1, scale=0.25, seed=6), path)
    return path


@pytest.mark.slow
def test_a_cut_runs_as_it_is(bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["cut", str(bag), str(tmp_path / "pair"), "--config", "kagaru", *OFTEN, *LEGS]) == 0
    printed = capsys.readouterr().out
    assert "uav2: 1.7 to 3.1 s of the flight, 11 image pairs" in printed
    assert "uav1, uav2: overlap " in printed
    assert "A cut hides: " in printed
    fleet = tmp_path / "pair" / "fleet.yaml"
    assert f"uav-vslam run {fleet}" in printed
    options = ["--workers", "1", "--no-plots", "--no-maps", "--no-smoothing", "--results", str(tmp_path)]
    assert main(["run", str(fleet), *options]) == 0
    summary = json.loads((tmp_path / "latest" / "summary.json").read_text())
    for name in ("uav1", "uav2"):
        assert summary["vehicles"][name]["frames_processed"] >= 11
        assert summary["vehicles"][name]["s_slam"]["ate_m"] < 0.5  # the start's sigma is 0.05 m and 0.1 m/s over 1.5 s
    assert sum(vehicle["link"]["packets_used"] for vehicle in summary["vehicles"].values()) > 0


def test_the_command_that_is_printed_can_be_pasted(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "two legs"
    assert main(["cut", str(bag), str(out), *LEGS]) == 0
    command = capsys.readouterr().out.splitlines()[-1].removeprefix(f"{out}: ")
    assert shlex.split(command) == ["uav-vslam", "run", str(out / "fleet.yaml")]


def test_legs_are_found(bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["cut", str(bag), str(tmp_path / "pair"), "--duration", "1.2"]) == 0
    assert "uav1: " in capsys.readouterr().out


@pytest.mark.slow
def test_an_estimate_takes_the_place_of_the_truth(bag: Path, tmp_path: Path) -> None:
    options = ["--no-plots", "--no-maps", "--no-smoothing", "--results", str(tmp_path)]
    assert main(["run", str(bag), "--config", "kagaru", *options]) == 0
    estimate = tmp_path / "latest" / "uav1_s_slam.tum"
    assert main(["cut", str(bag), str(tmp_path / "pair"), "--trajectory", str(estimate), *LEGS]) == 0
    second, flight = open_flight(tmp_path / "pair", "uav2"), open_flight(bag, "uav1")
    assert second.truth() is None
    assert second.initial_state is not None
    poses, start = read_trajectory(estimate), second.initial_state.state
    at = int(np.argmin(np.linalg.norm(poses.positions - start.T_map_body.t, axis=1)))
    np.testing.assert_allclose(start.T_map_body.t, poses.positions[at], atol=1e-6)
    assert poses.stamps_ns[at] - poses.stamps_ns[0] == pytest.approx(1.68e9, abs=1e7)
    truth = flight.truth()
    assert truth is not None
    k = int(np.searchsorted(truth.stamps_ns, poses.stamps_ns[at]))
    np.testing.assert_allclose(start.v_map, truth.velocities_world[k], atol=1.5)  # m/s, of differences over 0.14 s


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--legs", "0-1,9-10"], "leg 9-10 s has 0 image pairs"),
        (["--duration", "5"], "2 legs of 5 s do not fit into a flight of 3 s"),
        (["--set", "input.topics.truth=nowhere"], "/uav1/nowhere along which it could be cut"),
        (["--trajectory", "nowhere.tum"], "nowhere.tum"),
        (["--vehicles", "121"], "121 legs are too many"),
        ([*LEGS, "--vehicles", "2", "--overlap", "0.5"], "leave out --vehicles, --overlap"),
        ([*LEGS, "--duration", "1"], "leave out --duration"),
        (["--trajectory", "x.tum", "--seed", "1"], "leave out --seed"),
    ],
)
def test_what_can_not_be_cut_is_one_line(
    bag: Path, tmp_path: Path, options: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["cut", str(bag), str(tmp_path / "pair"), *options]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
    assert not (tmp_path / "pair").exists()


def test_a_damaged_recording_is_cut_from_before_the_damage(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    whole, short = (bag / "flight.mcap").read_bytes(), tmp_path / "short.mcap"
    short.write_bytes(whole[: len(whole) * 3 // 4])
    assert main(["cut", str(short), str(tmp_path / "pair"), "--legs", "0-1,1-2"]) == 2
    said = capsys.readouterr()
    assert said.err.startswith(f"uav-vslam: cut from what is before a break: bag {short} is damaged")
    assert said.err.count("\n") == 1
    assert open_flight(tmp_path / "pair", "uav2").frame_count == 7
    assert main(["cut", str(bag), str(tmp_path / "expected"), "--legs", "0-1,1-2"]) == 0
    ours, theirs = (list(iter_raw([tmp_path / name])) for name in ("pair", "expected"))
    assert [raw.data for raw in ours] == [raw.data for raw in theirs]


def test_messages_that_can_not_be_read_are_left_out_and_told(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with RawRecorder(tmp_path / "faulty") as recorder:
        numbers = {"/uav1/left/image_raw": itertools.count(), "/uav1/imu/data_raw": itertools.count()}
        for raw in iter_raw([bag]):
            number = next(numbers[raw.topic]) if raw.topic in numbers else -1
            data = {5: raw.data[:40], 100: raw.data[:4]}.get(number, raw.data)
            recorder.write(raw.topic, raw.msgtype, data, raw.stamp_ns)
    assert main(["cut", str(tmp_path / "faulty"), str(tmp_path / "pair"), *LEGS]) == 0
    said = capsys.readouterr().err
    assert "3 messages can't be read and are left out, images with their pair; the first: " in said
    assert open_flight(tmp_path / "pair", "uav1").frame_count == open_flight(tmp_path / "pair", "uav2").frame_count - 1


def test_an_existing_folder_is_refused_at_once(bag: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["cut", str(bag), str(bag)]) == 2
    assert "exists" in capsys.readouterr().err


def test_a_folder_that_can_not_be_made_is_refused_before_the_recording_is_read(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").write_text("no folder")
    assert main(["cut", str(tmp_path / "no_bag"), str(tmp_path / "file" / "pair")]) == 2
    error = capsys.readouterr().err
    assert "can't be made" in error
    assert error.count("\n") == 1


def test_a_cut_that_was_killed_starts_again(bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    left = tmp_path / "pair.partial" / "pair"
    left.mkdir(parents=True)
    (left / "pair.mcap").write_bytes(b"begun")
    assert main(["cut", str(bag), str(tmp_path / "pair"), *LEGS]) == 0
    assert "cut short, is removed" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["pair"]
    assert open_flight(tmp_path / "pair", "uav2").frame_count == 11


@pytest.mark.parametrize(
    "options",
    [
        ["--legs", "0-1"],
        ["--legs", "a-b,c-d"],
        ["--legs", "0-10,20-inf"],
        ["--legs", "0-1,2-1e300"],
        ["--vehicles", "1"],
        ["--overlap", "2"],
        ["--within", "inf"],
        ["--duration", "inf"],
    ],
)
def test_arguments_that_mean_nothing_are_refused(
    bag: Path, tmp_path: Path, options: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as leaving:
        main(["cut", str(bag), str(tmp_path / "pair"), *options])
    assert leaving.value.code == 2
    assert options[0] in capsys.readouterr().err
