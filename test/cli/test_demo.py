# SPDX-License-Identifier: Apache-2.0
"""The demo from its start to the report, with the real node graph."""

import json
from pathlib import Path

import pytest

from uav_vslam.cli.main import main


@pytest.mark.slow
def test_the_demo_flies_both_vehicles_and_reports_on_them(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["demo", "--results", str(tmp_path), "--no-plots"]) == 0
    vehicles = json.loads((tmp_path / "latest" / "summary.json").read_text())["vehicles"]
    assert {name: figures["frames_processed"] for name, figures in vehicles.items()} == {"uav1": 64, "uav2": 64}
    assert all(figures["c_slam"]["ate_m"] < figures["ins"]["ate_m"] for figures in vehicles.values())
    assert "start yaw" in capsys.readouterr().out


def test_a_folder_that_keeps_a_demo_is_refused_by_the_option_that_named_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "demo").mkdir()
    assert main(["demo", "--keep", str(tmp_path)]) == 2
    said = capsys.readouterr()
    assert "demo exists already; choose another folder for --keep" in said.err
    assert said.out == ""


@pytest.mark.ros
def test_a_demo_that_is_interrupted_has_not_failed(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for code, told in ((130, False), (1, True)):
        monkeypatch.setattr("uav_vslam.cli.launch.launch", lambda *_, code=code, **__: code)
        assert main(["demo"]) == code
        assert ("the node graph failed" in capsys.readouterr().err) == told
