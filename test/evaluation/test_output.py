# SPDX-License-Identifier: Apache-2.0
import dataclasses
import errno
import json
import subprocess

import numpy as np
import pytest
import yaml

from uav_vslam.errors import UavVslamError
from uav_vslam.evaluation.files.results_folder import read_results
from uav_vslam.evaluation.output import write_results, write_study
from uav_vslam.evaluation.revision import git_revision
from uav_vslam.evaluation.study import study_tree


def test_a_results_folder_holds_everything(flight, tmp_path):
    folder = write_results(flight, tmp_path)
    assert folder.parent == tmp_path
    assert folder.name.endswith("_pair_flight")
    tracks = {f"{name}_{track}.tum" for name in flight.vehicles for track in ("truth", "ins", "s_slam", "c_slam")}
    with_covariance = {f"{name}_{track}.csv" for name in flight.vehicles for track in ("s_slam", "c_slam")}
    assert {path.name for path in folder.iterdir()} == tracks | with_covariance | {"summary.json", "config.yaml"}
    assert json.loads((folder / "summary.json").read_text())["vehicles"]["uav1"]["frames_in"] == 121
    assert yaml.safe_load((folder / "config.yaml").read_text()) == flight.config


def test_latest_links_to_the_newest_and_names_never_collide(flight, tmp_path):
    first, second = write_results(flight, tmp_path), write_results(flight, tmp_path)
    assert first != second
    assert (tmp_path / "latest").is_symlink()
    assert (tmp_path / "latest").resolve() == second.resolve()
    assert {path.name for path in tmp_path.iterdir()} == {first.name, second.name, "latest"}


def test_a_folder_whose_writing_fails_says_so_by_its_name_and_latest_stays_on_a_complete_one(flight, tmp_path):
    complete = write_results(flight, tmp_path)

    def fail(result, folder):
        raise OSError(errno.ENOSPC, "No space left on device", str(folder / "plan.png"))

    with pytest.raises(OSError, match="No space left") as failed:
        write_results(flight, tmp_path, plot=fail)
    (incomplete,) = tmp_path.glob("*.incomplete")
    assert failed.value.filename == str(incomplete / "plan.png")
    assert (incomplete / "summary.json").exists()
    assert (tmp_path / "latest").resolve() == complete.resolve()
    assert {path.name for path in tmp_path.iterdir()} == {complete.name, incomplete.name, "latest"}


@pytest.mark.parametrize("code", [errno.EPERM, errno.EOPNOTSUPP])
def test_results_on_a_file_system_without_links_are_complete(flight, tmp_path, monkeypatch, code):
    """As on FAT and some network shares, which a test can't mount."""

    def refuse(*_, **__):
        raise OSError(code, "no links here")

    monkeypatch.setattr("os.symlink", refuse)
    folder = write_results(flight, tmp_path)
    assert (folder / "summary.json").exists()
    assert list(tmp_path.iterdir()) == [folder]


def test_a_real_folder_named_latest_is_not_touched(flight, tmp_path):
    (tmp_path / "latest").mkdir()
    with pytest.raises(UavVslamError, match="symbolic link"):
        write_results(flight, tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["latest"]


def test_plots_are_drawn_into_the_folder(flight, tmp_path):
    drawn = []
    folder = write_results(flight, tmp_path, plot=lambda result, where: drawn.append((result.name, where)) or [])
    assert drawn == [("pair flight", folder)]


def test_a_missing_track_has_no_file(single_flight, tmp_path):
    names = {path.name for path in write_results(single_flight, tmp_path).glob("*.tum")}
    assert names == {"uav1_ins.tum", "uav1_s_slam.tum"}


def test_a_smoothed_track_is_scored_and_read_again_with_its_covariance(single_flight, tmp_path):
    vehicle = single_flight.vehicles["uav1"]
    smoothed = dataclasses.replace(vehicle, smoothed=vehicle.s_slam)
    folder = write_results(dataclasses.replace(single_flight, vehicles={"uav1": smoothed}), tmp_path)
    figures = json.loads((folder / "summary.json").read_text())["vehicles"]["uav1"]
    assert figures["smoothed"] == figures["s_slam"]
    read = read_results(folder)["uav1"]["smoothed"]
    assert np.abs(read.covariance - vehicle.s_slam.covariance).max() < 1e-9


def git(folder, *arguments):
    identity = ("-c", "user.name=t", "-c", "user.email=t@example.org")
    subprocess.run(("git", *identity, *arguments), cwd=folder, check=True, capture_output=True)


def test_the_revision_is_marked_dirty_when_the_tree_differs(tmp_path):
    assert git_revision(tmp_path) is None
    git(tmp_path, "init")
    (tmp_path / "file").write_text("one")
    git(tmp_path, "add", "file")
    git(tmp_path, "commit", "-m", "one")
    clean = git_revision(tmp_path)
    (tmp_path / "file").write_text("two")
    assert git_revision(tmp_path) == f"{clean}-dirty"
    assert len(clean) >= 7


def test_a_study_is_kept_as_data_and_as_a_table(tmp_path):
    rows = [
        {"method": "eif", "condition": "calm", "end_rms_m": np.float64(1.234567), "failures": np.int64(0)},
        {"method": "ukf", "condition": "gap", "end_rms_m": float("nan"), "failures": 2, "ms_per_frame": 123.4},
    ]
    folder = write_study(study_tree("filters", rows, [1, 2]), tmp_path)
    tree = json.loads((folder / "study.json").read_text())
    assert (tree["study"], tree["seeds"]) == ("filters", [1, 2])
    assert tree["rows"][0] == {"method": "eif", "condition": "calm", "end_rms_m": 1.234567, "failures": 0}
    assert tree["rows"][1]["end_rms_m"] is None
    table = (folder / "study.md").read_text().splitlines()
    assert "2 seeds: 1, 2" in table[2]
    assert table[4:] == [
        "| method | condition | end_rms_m | failures | ms_per_frame |",
        "| ------ | --------- | --------- | -------- | ------------ |",
        "| eif    | calm      | 1.23      | 0        | –            |",
        "| ukf    | gap       | –         | 2        | 123          |",
    ]
    assert (tmp_path / "latest").resolve() == folder.resolve()


def test_a_study_of_several_tables_has_a_heading_and_columns_for_each(tmp_path):
    rows = [
        {"table": "Consistency", "method": "eif", "nees_position": 0.9},
        {"table": "Noise", "run": "R1", "w1": 0.1},
        {"table": "Consistency", "method": "ukf", "nees_position": 1.1},
    ]
    folder = write_study(study_tree("filters", rows, [1], notes={"RER": "SLAM over INS"}), tmp_path)
    page = (folder / "study.md").read_text().splitlines()
    assert page[4:10] == [
        "## Consistency",
        "",
        "| method | nees_position |",
        "| ------ | ------------- |",
        "| eif    | 0.9           |",
        "| ukf    | 1.1           |",
    ]
    assert page[11:15] == ["## Noise", "", "| run | w1  |", "| --- | --- |"]
    assert page[-1] == "**RER**: SLAM over INS"


def test_a_wide_table_is_divided_into_tables_that_fit_and_keep_the_labels(tmp_path):
    figures = {f"a_figure_with_a_long_name_{k}": 0.1 * k for k in range(9)}
    rows = [{"method": name, "condition": "calm", **figures} for name in ("eif", "ukf")]
    page = (write_study(study_tree("filters", rows, [1]), tmp_path) / "study.md").read_text().splitlines()[4:]
    assert max(map(len, page)) <= 120
    heads = [[cell.strip() for cell in line.split("|")[1:-1]] for line in page if line.startswith("| method")]
    assert all(head[:2] == ["method", "condition"] and len(head) > 2 for head in heads)
    assert [name for head in heads for name in head[2:]] == list(figures)
    assert sum(line.startswith("| ukf ") for line in page) == len(heads) == 3


def test_a_column_wider_than_the_page_has_a_table_of_its_own(tmp_path):
    rows = [{"method": "eif", "figures": "x" * 150, "runs": 3}]
    page = (write_study(study_tree("filters", rows, [1]), tmp_path) / "study.md").read_text().splitlines()
    heads = [line.split() for line in page if line.startswith("| method")]
    assert [head[3] for head in heads] == ["figures", "runs"]


def test_a_study_is_drawn_from_what_was_written(tmp_path):
    drawn = []
    curve = {"method": "eif", "error_m": [1.0, np.float64(2.0), float("nan")]}
    tree = study_tree("long", [], [1], series=[curve])
    folder = write_study(tree, tmp_path, plot=lambda tree, where: drawn.append((tree, where)) or [])
    tree = json.loads((folder / "study.json").read_text())
    assert tree["series"] == [{"method": "eif", "error_m": [1.0, 2.0, None]}]
    assert drawn == [(tree, folder)]


def test_names_are_made_safe_for_folders(flight, tmp_path):
    folder = write_results(dataclasses.replace(flight, name="../a b/ü:"), tmp_path)
    assert folder.parent == tmp_path
    assert folder.name.endswith("_a_b_ü_") or folder.name.endswith("_a_b_ü")
