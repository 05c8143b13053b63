# SPDX-License-Identifier: Apache-2.0
"""The bench measures every stage."""

import dataclasses
import json
from pathlib import Path

import pytest

from uav_vslam.cli.main import main
from uav_vslam.evaluation.output import LATEST
from uav_vslam.studies.bench import compute


@pytest.mark.ros
@pytest.mark.slow
def test_the_cost_of_each_node_is_a_ratio_to_a_bare_one_in_the_same_run(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("uav_vslam.ros.node_cost.WARM_UP_S", 0.5)
    assert main(["bench", "--nodes", "2"]) == 0
    lines = [line for line in capsys.readouterr().out.splitlines() if line.count("│") == 8]
    rows = {
        (rate, node): texts for rate, node, *texts in ([part.strip() for part in x.split("│")[1:-1]] for x in lines)
    }
    assert {rate for rate, _ in rows} == {"at rest", "200", "400"}
    for rate in ("200", "400"):
        node, bare = (rows[rate, name] for name in ("ins_propagator", "bare_odometry"))
        assert float(node[1]) == pytest.approx(float(node[0]) / float(bare[0]), rel=0.02)
        assert float(bare[1]) == 1.0
        assert float(node[2]) < float(bare[2])  # 50 a second beside one per reading
        for name in ("stereo_frontend", "slam_backend", "fusion"):  # nobody reads odometry of theirs
            assert rows[rate, name][2:] == ["–"] * 3
    assert rows["at rest", "ins_propagator"][1:] == ["–"] * 4


@pytest.mark.ros
def test_the_latencies_of_the_nodes_have_their_unit(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("uav_vslam.ros.node_cost.node_costs", lambda seconds: iter(()))
    assert main(["bench", "--nodes", "2"]) == 0
    assert capsys.readouterr().out.count("[ms]") == 2


@pytest.mark.slow
def test_the_quick_bench_measures_every_stage_and_writes_the_study(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(compute, "QUICK", dataclasses.replace(compute.QUICK, repeats=1))
    assert main(["bench", "--quick", "--results", str(tmp_path)]) == 0
    rows = json.loads((tmp_path / LATEST / "study.json").read_text())["rows"]
    stages = [row["method"] for row in rows]
    assert stages.count("back end") == 6
    assert stages.count("fusion") == stages.count("weight search") == 3
    assert stages.count("bag reading") == 2
    assert stages.count("make packet") == stages.count("read packet") == 2
    singles = {
        "stereo front end",
        "live front end",
        "graph transformation",
        "dominating set",
        "preintegration",
        "import",
    }
    assert set(stages) == singles | {"bag reading", "back end", "fusion", "weight search", "make packet", "read packet"}
    for row in rows:
        assert row["ratio_to_reference"] > 0
        assert row.get("ms_per_frame", 0) + row.get("ms_per_packet", 0) > 0
    assert [row["landmarks"] for row in rows if row["method"] == "fusion"] == [10, 50, 200]
    for row, landmarks in zip(
        [row for row in rows if row["method"] == "back end"], (50, 100, 200, 400, 200, 200), strict=True
    ):
        assert row["landmarks"] == pytest.approx(landmarks, rel=0.1)  # those that are leaving count as well
        assert row["gtsam_landmarks"] >= landmarks
        assert row["gtsam_ms_per_frame"] > 0
    printed = capsys.readouterr().out
    assert "preintegration" in printed
    assert "GTSAM" in printed
