# SPDX-License-Identifier: Apache-2.0
"""`uav-vslam run` says at its start which changed settings decide nothing."""

import dataclasses
from pathlib import Path

import pytest

from uav_vslam.cli.main import main
from uav_vslam.simulation.recording import record
from uav_vslam.simulation.scenario import SCENARIOS

WARNING = "uav-vslam: warning: "


@pytest.fixture(scope="module")
def flight(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("flight") / "flight"
    record(dataclasses.replace(SCENARIOS["kagaru"], vehicles=2, frames=4, scale=0.125, seed=3), path)
    return path


@pytest.mark.parametrize(("method", "count"), [("klt", 1), ("sift", 0)])
def test_association_with_klt_is_warned_about_once_for_all_vehicles(
    flight: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], method: str, count: int
) -> None:
    changes = ["--set", "backend.association=hgtm", "--set", f"frontend.method={method}"]
    assert main(["run", str(flight), *changes, "--no-plots", "--workers", "1", "--results", str(tmp_path)]) == 0
    lines = [line for line in capsys.readouterr().err.splitlines() if "backend.association" in line]
    assert len(lines) == count
    assert all(line.startswith(f"{WARNING}backend.association = hgtm decides almost nothing") for line in lines)
