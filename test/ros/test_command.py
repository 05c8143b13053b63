# SPDX-License-Identifier: Apache-2.0
"""The command of a node is the installed program, or its module."""

import sys
from pathlib import Path

import pytest

from uav_vslam.ros.command import find_executable


def test_installed_programs_are_preferred_to_modules(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path))
    assert find_executable("fusion") == [sys.executable, "-m", "uav_vslam.ros.fusion_node"]
    program = tmp_path / "lib" / "uav_vslam" / "fusion"
    program.parent.mkdir(parents=True)
    program.touch(mode=0o755)
    assert find_executable("fusion") == [str(program)]
