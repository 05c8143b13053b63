# SPDX-License-Identifier: Apache-2.0
"""The command as its tests run it."""

from pathlib import Path

import pytest

from uav_vslam.cli.main import main


def refused(capsys: pytest.CaptureFixture[str], *arguments: str | Path) -> str:
    """Run the command, which must refuse with exit code 2 and a single line; return the line."""
    assert main([str(argument) for argument in arguments]) == 2
    error = capsys.readouterr().err
    assert error.startswith("uav-vslam: ")
    assert error.count("\n") == 1, error
    return error
