# SPDX-License-Identifier: Apache-2.0
"""`evaluate` on trajectory files and results folders of a made-up flight."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
from command import refused
from made_up_flight import FLIGHT, TRUTH, VEHICLE

from uav_vslam.cli.main import main
from uav_vslam.evaluation.clock_offset import later
from uav_vslam.evaluation.files.writing import write_csv, write_kitti, write_tum
from uav_vslam.evaluation.output import write_results
from uav_vslam.evaluation.summary import build_summary


@pytest.fixture
def results(tmp_path: Path) -> Path:
    """The link to the results of the flight."""
    write_results(FLIGHT, tmp_path / "results")
    return tmp_path / "results" / "latest"


@pytest.fixture
def files(tmp_path: Path) -> dict[str, Path]:
    """The truth and the own-only track in every format."""
    return {
        "truth": write_csv(TRUTH, tmp_path / "truth.csv"),
        "tum": write_tum(VEHICLE.s_slam, tmp_path / "s_slam.tum"),
        "csv": write_csv(VEHICLE.s_slam, tmp_path / "s_slam.csv"),
        "kitti": write_kitti(VEHICLE.s_slam, tmp_path / "s_slam.txt"),
        "times": tmp_path / "s_slam_times.txt",
    }


def evaluate(root: Path, *arguments: str | Path) -> dict:
    """Run the verb, and return what it wrote."""
    assert main(["evaluate", *map(str, arguments), "--results", str(root), "--no-plots"]) == 0
    (folder,) = root.glob("*_comparison")
    return json.loads((folder / "comparison.json").read_text())


def test_a_results_folder_has_the_figures_of_its_own_summary(results: Path, tmp_path: Path) -> None:
    tree = evaluate(tmp_path / "out", results)
    summary = build_summary(FLIGHT, git=None)["vehicles"]["uav1"]
    runs = dict(zip(("ins", "s_slam", "c_slam"), tree["runs"], strict=True))
    for name, run in runs.items():
        assert run["track"] == f"uav1 {name.upper().replace('_', '-')}"
        assert run["poses_with_truth"] == summary[name]["poses"]
        assert run["ate_m"]["none"] == pytest.approx(summary[name]["ate_m"], abs=1e-8)
        assert run["end_m"]["none"] == pytest.approx(summary[name]["end_m"], abs=1e-8)
    for name in ("s_slam", "c_slam"):
        assert runs[name]["nees_position"] == pytest.approx(summary[name]["nees_position"], rel=1e-6)
        assert runs[name]["nees_rotation"] == pytest.approx(summary[name]["nees_rotation"], rel=1e-6)


def test_the_same_poses_give_the_same_figures_in_every_format(files: dict[str, Path], tmp_path: Path) -> None:
    tree = evaluate(
        tmp_path / "out",
        files["tum"],
        files["csv"],
        files["kitti"],
        "--truth",
        files["truth"],
        "--times",
        files["times"],
    )
    tum, csv, kitti = tree["runs"]
    for other in (csv, kitti):
        for key in ("ate_m", "end_m", "rotation_rms_deg"):
            assert other[key] == pytest.approx(tum[key], abs=1e-6)
        assert other["rpe"] == pytest.approx(tum["rpe"], abs=1e-6)
    assert len({run["source"] for run in tree["runs"]}) == 3  # although all are called s_slam
    assert csv["nees_position"] is not None
    assert tum["nees_position"] is None


@pytest.mark.slow
def test_evaluating_results_leaves_latest_where_it_is_and_draws(results: Path, capsys) -> None:
    before = results.resolve()
    for _ in range(2):  # the same command works twice
        assert main(["evaluate", str(results), "--results", str(results.parent), "--alignment", "start-yaw"]) == 0
    assert results.resolve() == before
    assert len(list(results.parent.glob("*_comparison*/comparison.png"))) == 2
    assert "C-SLAM" in capsys.readouterr().out


def test_poses_without_truth_are_counted(files: dict[str, Path], tmp_path: Path, capsys) -> None:
    half = write_csv(TRUTH.select(np.arange(1000)), tmp_path / "half.csv")
    (run,) = evaluate(tmp_path / "out", files["tum"], "--truth", half)["runs"]
    assert (run["poses"], run["poses_with_truth"]) == (200, 100)
    assert "s_slam: 100 of 200 poses have ground truth; only they count" in capsys.readouterr().err


def test_another_clock_of_the_truth_is_named_and_its_offset_taken(tmp_path: Path, capsys) -> None:
    t = (TRUTH.stamps_ns - TRUTH.stamps_ns[0]) * 1e-9
    there_and_back = dataclasses.replace(TRUTH, positions=np.outer(np.cos(t), [30.0, 5.0, 0.0]))
    estimate = write_tum(there_and_back, tmp_path / "mine.tum")
    truth = write_csv(later(there_and_back, -0.4), tmp_path / "truth.csv")
    (unaware,) = evaluate(tmp_path / "unaware", estimate, "--truth", truth)["runs"]
    assert unaware["ate_m"]["none"] > 5.0
    assert unaware["clock_offset"]["offset_s"] == pytest.approx(0.4, abs=0.001)
    assert "mine: the clock of the ground truth seems to be off: with +0.400 s" in capsys.readouterr().err
    evaluate(tmp_path / "wrong", estimate, "--truth", truth, "--truth-offset", "1")
    assert "-0.600 s more added to its stamps" in (said := capsys.readouterr().err)
    assert "--truth-offset 0.400" in said  # in place of the 1 s, not beside it
    tree = evaluate(tmp_path / "aware", estimate, "--truth", truth, "--truth-offset", "0.4")
    (aware,) = tree["runs"]
    assert (tree["inputs"], tree["truth"], tree["truth_offset_s"]) == ([str(estimate)], str(truth), 0.4)
    assert aware["ate_m"]["none"] < 1e-6
    assert aware["clock_offset"] is None
    assert "clock" not in capsys.readouterr().err


def test_what_can_not_be_evaluated_is_refused_in_one_line(files, results: Path, tmp_path: Path, capsys) -> None:
    assert "s_slam.tum needs a ground truth; give --truth" in refused(capsys, "evaluate", files["tum"])
    (tmp_path / "folder").mkdir()
    assert "holds no trajectories such as uav1_s_slam.tum" in refused(capsys, "evaluate", tmp_path / "folder")
    assert "nowhere" in refused(capsys, "evaluate", tmp_path / "nowhere", "--truth", files["truth"])
    (files["kitti"].parent / "s_slam_times.txt").unlink()
    assert "its 200 poses are not the 2000" in refused(capsys, "evaluate", files["kitti"], "--truth", files["truth"])
    for path in results.glob("*_truth.tum"):
        path.unlink()
    assert "holds no ground truth of uav1; give --truth" in refused(capsys, "evaluate", results)
    times = ["--times", files["times"]]
    assert "--times belongs to KITTI" in refused(capsys, "evaluate", files["tum"], "--truth", files["truth"], *times)
    (tmp_path / "flight.mcap").touch()
    error = refused(capsys, "evaluate", files["tum"], tmp_path / "flight.mcap", "--truth", files["truth"])
    assert "flight.mcap is a bag" in error


def test_one_truth_is_not_that_of_two_vehicles(files: dict[str, Path], results: Path, tmp_path: Path, capsys) -> None:
    """Against another vehicle's truth a good estimate is metres off, as if the clocks differed."""
    evaluate(tmp_path / "one", results, "--truth", files["truth"])
    capsys.readouterr()
    for path in results.glob("uav1_*.tum"):
        (results / path.name.replace("uav1", "uav2")).write_bytes(path.read_bytes())
    said = refused(capsys, "evaluate", results, "--truth", files["truth"])
    assert "holds uav1 and uav2, and --truth is of one vehicle" in said
    evaluate(tmp_path / "two", results / "uav2_s_slam.tum", "--truth", files["truth"])


@pytest.mark.parametrize("offset", ["nan", "1e300", "soon"])
def test_an_offset_that_no_clock_has_is_refused(offset: str, capsys) -> None:
    with pytest.raises(SystemExit) as leaving:
        main(["evaluate", "nowhere", "--truth-offset", offset])
    assert leaving.value.code == 2
    assert "is not a time in seconds" in capsys.readouterr().err


@pytest.mark.parametrize(
    "option", [["--segments", "10,-5"], ["--segments", "x"], ["--max-gap", "0"], ["--max-gap", "1e300"]]
)
def test_wrong_options_are_refused_before_any_work(option: list[str], capsys) -> None:
    with pytest.raises(SystemExit) as leaving:
        main(["evaluate", "nowhere", *option])
    assert leaving.value.code == 2
    assert "above 0" in capsys.readouterr().err
