# SPDX-License-Identifier: Apache-2.0
"""Long work tells how far it is, on a terminal and in a log."""

import sys

import pytest
from rich.console import Console

from uav_vslam.cli import progress
from uav_vslam.cli.progress import progress_bar


def test_where_output_is_no_terminal_lines_tell_how_far_it_is(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    clock_s = iter([0.0, 59.0, 61.0, 119.0, 600.0])
    monkeypatch.setattr(progress.time, "monotonic", lambda: next(clock_s))
    with progress_bar("study filters", 12) as advance:
        advance()
        advance()
        advance(3)
        advance(7)
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.splitlines() == ["study filters: 2 of 12 after 1 min", "study filters: 12 of 12 after 10 min"]


def test_a_terminal_gets_a_bar(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True)
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setattr("rich.progress.get_console", lambda: Console(force_terminal=True))
    with progress_bar("flying", 2) as advance:
        advance(2)
    captured = capsys.readouterr()
    assert "flying" in captured.out
    assert "100%" in captured.out
    assert captured.err == ""
