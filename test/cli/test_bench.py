# SPDX-License-Identifier: Apache-2.0
"""The bench measures every stage, and its ratios mean what they say."""

import json
import time
from pathlib import Path

import pytest

from uav_vslam.cli.main import main
from uav_vslam.evaluation.output import LATEST
from uav_vslam.studies.speed import take_turns


def test_the_quick_bench_measures_every_stage_and_writes_the_study(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["bench", "--quick", "--results", str(tmp_path)]) == 0
    rows = json.loads((tmp_path / LATEST / "study.json").read_text())["rows"]
    stages = [row["method"] for row in rows]
    assert stages.count("back end") == 3
    assert stages.count("fusion") == 2
    singles = {"stereo front end", "make packet", "validate packet", "preintegration", "bag reading"}
    assert set(stages) == singles | {"back end", "fusion"}
    for row in rows:
        assert row["ratio"] > 0
        assert row.get("ms_per_frame", 0) + row.get("ms_per_packet", 0) > 0
    assert [row["landmarks"] for row in rows if "landmarks" in row] == [50, 100, 200, 10, 50]
    assert "preintegration" in capsys.readouterr().out


def test_the_ratio_is_that_of_neighbours() -> None:
    ms, ratio = take_turns([lambda: time.sleep(0.04)] * 3, lambda: time.sleep(0.01))
    assert 40.0 <= ms < 80.0
    assert 2.0 < ratio <= 4.2  # sleeping takes longer than asked for, the shorter one relatively more
