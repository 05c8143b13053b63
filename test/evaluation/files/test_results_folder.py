# SPDX-License-Identifier: Apache-2.0
from pathlib import Path

from uav_vslam.evaluation.files.results_folder import distinct_names


def test_equal_names_of_folders_are_told_apart(tmp_path: Path) -> None:
    a, b = tmp_path / "2026-01-31_120000_x", tmp_path / "2026-01-31_130000_x"
    a.mkdir()
    b.mkdir()
    assert distinct_names([a, b]) == [a.name, b.name]
    assert distinct_names([a]) == ["x"]
    assert distinct_names([a, a]) == ["1 x", "2 x"]


def test_equal_names_of_files_are_told_apart(tmp_path: Path) -> None:
    a, b = tmp_path / "a" / "x.tum", tmp_path / "b" / "x.tum"
    assert distinct_names([a, b]) == ["a/x.tum", "b/x.tum"]
    assert distinct_names([a]) == ["x"]
