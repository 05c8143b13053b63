# SPDX-License-Identifier: Apache-2.0
"""A vehicle is launched once on a computer; a launcher that was killed is in nobody's way."""

from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import pytest

from uav_vslam.cli.main import main
from uav_vslam.slam.state_folder import state_folder
from waiting import wait_for

pytestmark = pytest.mark.ros
Launched = Callable[..., AbstractContextManager[Any]]


def test_a_second_launch_of_a_vehicle_is_refused_until_the_first_is_gone(
    launched: Launched, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    fleet, other = tmp_path / "fleet.yaml", tmp_path / "other.yaml"
    fleet.write_text("vehicles: {uav1: {}}\nmode: none\n")
    other.write_text("vehicles: {uav2: {}, uav1: {}}\nmode: none\n")
    with launched(str(fleet)) as first:
        assert wait_for(lambda: (state_folder() / "uav1.session").exists())
        assert main(["launch", str(other)]) == 2
        error = capsys.readouterr().err
        assert f"uav1 already runs on this computer: process {first.process.pid} (" in error
        assert f"launch {fleet}" in error
        assert error.count("\n") == 1
        first.process.kill()
        first.process.wait()
        (state_folder() / "uav1.session").unlink()
        with launched(str(other)):
            assert wait_for(lambda: (state_folder() / "uav1.session").exists())
