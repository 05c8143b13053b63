# SPDX-License-Identifier: Apache-2.0
"""All studies publish rows of one schema: what is published is checked, and each study has its place."""

from pathlib import Path
from typing import Any

import pytest

from uav_vslam import studies
from uav_vslam.evaluation.scores import ERROR_KEYS, NEES_KEYS
from uav_vslam.studies.engine.columns import COLUMNS, TRACKS, check_rows, legend
from uav_vslam.studies.engine.score_columns import COLUMN_OF, pooled_scores
from uav_vslam.studies.engine.study import Findings
from uav_vslam.studies.registry import STUDIES

ROW = {"method": "eif", "condition": "1 px", "ate_rms_m": 0.5}
AGREED = ("end_rms_m", "ate_rms_m", "ratio_to_s_slam", "nees_position", "failures", "runs", "ms_per_frame")


@pytest.mark.parametrize("key", ["ate", "ate_m", "nees", "ins_ate_rms_m", "setting"])
def test_a_column_that_is_not_declared_is_refused_before_it_is_published(key: str) -> None:
    with pytest.raises(ValueError, match=f"'{key}'"):
        Findings([ROW, {**ROW, key: 1.0}])


@pytest.mark.parametrize("row", [{"method": "eif"}, {"condition": "1 px"}, {**ROW, "condition": 1.0}])
def test_a_row_that_does_not_say_what_it_is_of_is_refused(row: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match="no text under"):
        check_rows([row])


def test_a_track_before_a_key_makes_it_that_tracks_figure() -> None:
    check_rows([{**ROW, "s_slam_ate_rms_m": 1.0, "gtsam_ms_per_frame": 2.0}])
    assert not [key for key in COLUMNS if key.startswith(TRACKS)]


def test_the_legend_explains_each_column_once() -> None:
    text = legend([{**ROW, "s_slam_ate_rms_m": 1.0}, {**ROW, "runs": 3}])
    assert text == f"ate_rms_m: {COLUMNS['ate_rms_m']}; runs: {COLUMNS['runs']}"


def test_the_columns_that_were_agreed_are_there() -> None:
    assert set(AGREED) <= set(COLUMNS)


def test_every_score_of_a_run_has_its_column() -> None:
    assert {COLUMN_OF.get(key, key) for key in (*ERROR_KEYS, *NEES_KEYS)} <= set(COLUMNS)


def test_scores_of_many_runs_are_pooled_by_their_kind() -> None:
    pooled = pooled_scores([{"ate_m": 3.0, "nees_position": 1.0}, {"ate_m": 4.0, "nees_position": 2.0, "end_m": None}])
    assert (pooled["ate_rms_m"], pooled["nees_position"]) == pytest.approx((12.5**0.5, 1.5))
    assert (pooled["end_rms_m"], pooled["nees_rotation"]) == (None, None)


def test_every_study_has_a_folder_and_every_folder_is_a_study() -> None:
    folders = {path.parent.name for path in Path(studies.__file__).parent.glob("*/__init__.py")}
    assert folders == set(STUDIES) | {"engine", "bench"}
