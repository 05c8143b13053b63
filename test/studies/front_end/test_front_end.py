# SPDX-License-Identifier: Apache-2.0
"""The studies of the front end run from the command line and leave tables and pictures."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from uav_vslam.cli.main import main
from uav_vslam.evaluation.output import LATEST
from uav_vslam.simulation import camera_render, faults
from uav_vslam.simulation.faults import FAULTS
from uav_vslam.simulation.scenario import Scenario, SimulatedVehicle
from uav_vslam.simulation.terrain import ground_of
from uav_vslam.types import StereoFrame

pytestmark = pytest.mark.slow
KLT = "frontend.method=klt,frontend.search_scale=1.0,frontend.max_tracks=100"


@pytest.fixture(scope="module", autouse=True)
def one_ground() -> Iterator[None]:
    """All flights are over the same ground, whose texture need not be generated for each."""
    ground = ground_of(Scenario(seed=1))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(camera_render, "ground_of", lambda scenario: ground)
        yield


@pytest.fixture
def one_rendering(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every fault meets the same images, which need not be rendered for each; nobody may change them."""
    known: dict[Scenario, list[StereoFrame]] = {}

    def rendered(vehicle: SimulatedVehicle) -> list[StereoFrame]:
        if vehicle.scenario not in known:
            known[vehicle.scenario] = list(camera_render.RenderedFlight(vehicle))
            for frame in known[vehicle.scenario]:
                frame.left.flags.writeable = frame.right.flags.writeable = False
        return known[vehicle.scenario]

    monkeypatch.setattr(faults, "RenderedFlight", rendered)


def rows_of(results: Path, *arguments: str) -> list[dict[str, Any]]:
    options = ["--seeds", "1", "--scale", "0.2", "--workers", "1", "--variant", KLT, "--results", str(results)]
    assert main(["study", *arguments, *options]) == 0
    rows: list[dict[str, Any]] = json.loads((results / LATEST / "study.json").read_text())["rows"]
    return rows


def test_the_study_of_front_ends_judges_points_and_flies_them(tmp_path: Path) -> None:
    plain, unequal, blurred = rows_of(tmp_path, "front_end", "--frames", "6")
    assert (tmp_path / LATEST / "front_end.png").exists()
    for row in (plain, unequal, blurred):
        assert row["points_per_frame"] > 40
        assert row["sigma_px"] < 0.15
        assert row["beyond_1px_share"] <= 0.01
        assert row["followed_share"] > 0.5
    assert plain["kept_share"] == 1.0
    assert unequal["kept_share"] > 0.9
    assert plain["failures"] == 0
    assert "end_rms_m" not in unequal


@pytest.mark.usefixtures("one_rendering")
def test_the_study_of_faults_flies_through_each_and_tells_what_was_said(tmp_path: Path) -> None:
    rows = rows_of(tmp_path, "faults", "--frames", "14")
    assert (tmp_path / LATEST / "faults.png").exists()
    said = {row["condition"]: row["alarms"] for row in rows}
    assert list(said) == ["none", *FAULTS]
    assert said["none"] == "none"
    assert "image order" in said["left and right swapped, 1 s"]
    assert "left camera" in said["black images, 3 s"]
    assert "right camera" in said["black images, 3 s"]
    assert said["right camera frozen, 3 s"].startswith("right camera")
    assert "left image" in said["half as bright, 3 s"]
    coasted = {row["condition"]: row["frames_coasted"] for row in rows}
    assert coasted["none"] == 0  # nor is the first frame, which is the start state
    assert coasted["left and right swapped, 1 s"] >= 5
