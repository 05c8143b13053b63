# SPDX-License-Identifier: Apache-2.0
"""`export` of results folders and trajectory files."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from command import refused
from made_up_flight import FLIGHT, TRUTH, VEHICLE

from uav_vslam.cli.main import main
from uav_vslam.evaluation.files.reading import read_trajectory
from uav_vslam.evaluation.output import write_results


@pytest.fixture
def results(tmp_path: Path) -> Path:
    """The link to the results of the flight."""
    write_results(FLIGHT, tmp_path / "results")
    return tmp_path / "results" / "latest"


def test_all_tracks_are_exported_unless_some_are_named(results: Path, tmp_path: Path) -> None:
    shutil.copy(results / "uav1_c_slam.tum", results / "uav1_smoothed.tum")
    assert main(["export", str(results), "--format", "tum", "--out", str(tmp_path / "all")]) == 0
    written = {path.name for path in (tmp_path / "all").iterdir()}
    assert written == {path.name for path in results.glob("*.tum")}
    assert "uav1_smoothed.tum" in written


def test_results_are_exported_and_read_back(results: Path, tmp_path: Path, capsys) -> None:
    out = tmp_path / "out"
    assert main(["export", str(results), "--format", "csv", "--tracks", "truth", "c_slam", "--out", str(out)]) == 0
    assert sorted(path.name for path in out.iterdir()) == ["uav1_c_slam.csv", "uav1_truth.csv"]
    np.testing.assert_allclose(read_trajectory(out / "uav1_c_slam.csv").covariance, VEHICLE.c_slam.covariance)
    assert main(["export", str(out / "uav1_truth.csv"), "--format", "kitti"]) == 0
    back = read_trajectory(out / "uav1_truth_kitti.txt", times=out / "uav1_truth_kitti_times.txt")
    np.testing.assert_array_equal(back.stamps_ns, TRUTH.stamps_ns)
    np.testing.assert_allclose(back.positions, TRUTH.positions, atol=1e-8)
    assert "uav1_truth_kitti.txt" in capsys.readouterr().out


@pytest.mark.parametrize("datum", [["--datum", "-28.2325", "153.0012", "20"], ["--datum=-28.2325,153.0012,20"]])
def test_a_map_of_all_tracks_needs_a_datum(results: Path, tmp_path: Path, datum: list[str], capsys) -> None:
    out = tmp_path / "out"
    assert main(["export", str(results), "--format", "geojson", *datum, "--out", str(out)]) == 0
    features = json.loads((out / "flight.geojson").read_text())["features"]
    assert [feature["properties"]["name"] for feature in features] == [
        f"uav1_{name}" for name in ("truth", "ins", "s_slam", "c_slam")
    ]
    assert features[0]["geometry"]["coordinates"][0] == pytest.approx([153.0012, -28.2325, 70.0])
    assert "needs --datum LAT LON ALT" in refused(capsys, "export", results, "--format", "kml")
    assert "has no place for --datum" in refused(capsys, "export", results, "--format", "csv", "--datum", "1,2,3")
    assert "1,2 is not LAT LON ALT" in refused(capsys, "export", results, "--format", "kml", "--datum", "1,2")


def test_nothing_is_overwritten(results: Path, capsys) -> None:
    assert "uav1_truth.tum is there already" in refused(capsys, "export", results, "--format", "tum")


@pytest.mark.parametrize("out", ["a file", "a file/below"])
def test_where_nothing_can_be_written_is_told(results: Path, tmp_path: Path, out: str, capsys) -> None:
    (tmp_path / "a file").touch()
    said = refused(capsys, "export", results, "--format", "csv", "--out", tmp_path / out)
    assert "can't be written" in said
    assert "choose another folder by --out" in said


@pytest.mark.parametrize(
    ("name", "options", "said"),
    [
        ("", ["--yaw", "0"], "--format csv has no place for --yaw"),
        ("", ["--times", "nothing.txt"], "latest is a results folder"),
        ("uav1_truth.tum", ["--times", "nothing.txt"], "uav1_truth.tum has stamps of its own"),
        ("uav1_truth.tum", ["--tracks", "ins"], "--tracks belongs to a results folder"),
    ],
)
def test_options_without_effect_are_refused(
    results: Path, tmp_path: Path, name: str, options: list[str], said: str, capsys
) -> None:
    out = tmp_path / "out"
    assert said in refused(capsys, "export", results / name, "--format", "csv", *options, "--out", out)
    assert not out.exists()
