# SPDX-License-Identifier: Apache-2.0
"""A study's page holds its tables, notes and pictures."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from uav_vslam.errors import UavVslamError
from uav_vslam.evaluation.output import write_study
from uav_vslam.evaluation.study import study_tree
from uav_vslam.report.page import study_page
from uav_vslam.report.page.page import write_page

ROWS = [
    {"method": "a & b", "condition": "still", "end_rms_m": 1.2345, "runs": 3, "nees": None, "table": "first of two"},
    {"method": "c", "condition": "wind", "end_rms_m": 1234.5, "runs": 4, "nees": 1e-9, "table": "Second"},
    {"method": "d", "condition": "wind", "other": True, "table": "Second"},
]


def draw(tree: dict, folder: Path) -> list[Path]:
    path = folder / "errors_over_time.png"
    noise = np.random.default_rng(1).integers(0, 255, (300, 400, 3), np.uint8)  # 360 kB as PNG
    assert cv2.imwrite(str(path), noise)
    return [path]


def test_the_page_of_a_study_has_its_tables_notes_and_pictures(tmp_path: Path) -> None:
    folder = write_study(
        study_tree("study_x", ROWS, [1, 2], notes={"Columns": "what <they> mean"}), tmp_path, plot=draw
    )
    page = write_page([folder])
    text = page.read_text()
    for expected in (
        "First of two</h2>",
        "Second",
        "a &amp; b",
        "1.23",
        "1234",
        "1e-09",
        "what &lt;they&gt; mean",
        "2 seeds: 1, 2",
    ):
        assert expected in text
    assert "end_<wbr>rms_<wbr>m" in text
    assert 'alt="errors over time"' in text


def test_pictures_that_are_too_large_are_made_smaller(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = write_study(study_tree("study_x", ROWS, [1]), tmp_path, plot=draw)
    whole = write_page([folder], tmp_path / "whole.html").stat().st_size
    monkeypatch.setattr(study_page, "PICTURE_BYTES", 100_000)
    assert write_page([folder], tmp_path / "small.html").stat().st_size < whole - 300_000


def test_a_study_of_which_a_part_is_missing_is_told_in_one_line(tmp_path: Path) -> None:
    (tmp_path / "study.json").write_text('{"study": "x", "seeds": [1]}')
    with pytest.raises(UavVslamError, match="lacks git, rows"):
        write_page([tmp_path])


def test_a_study_without_seeds_rows_and_notes_has_a_page(tmp_path: Path) -> None:
    assert "no seeds" in write_page([write_study(study_tree("empty", [], []), tmp_path)]).read_text()


def test_a_study_has_a_page_of_its_own(tmp_path: Path) -> None:
    folder = write_study(study_tree("study_x", ROWS, [1]), tmp_path)
    with pytest.raises(UavVslamError, match="is a study"):
        write_page([folder, folder])
