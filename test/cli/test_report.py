# SPDX-License-Identifier: Apache-2.0
"""The command writes the page where it is told to, and refuses in one line."""

from pathlib import Path

import pytest
from made_up_results import write_full

from uav_vslam.cli.main import main


def test_the_page_goes_into_the_first_folder_or_where_it_is_asked_for(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder, output = write_full(tmp_path / "results"), tmp_path / "new" / "page.html"
    assert main(["report", str(folder)]) == 0
    assert main(["report", str(folder), str(folder), "--output", str(output)]) == 0
    assert capsys.readouterr().out == f"page: {folder / 'report.html'}\npage: {output}\n"
    assert (folder / "report.html").exists()
    assert output.exists()


def test_a_folder_without_results_is_refused_in_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["report", str(tmp_path)]) == 2
    assert capsys.readouterr().err.count("\n") == 1
