# SPDX-License-Identifier: Apache-2.0
"""A full disk is one line and exit code 1, and costs neither the result table nor leaves a broken bag.

The disk of these tests is a limit on the size of files, which any user can set.
"""

import dataclasses
import os
import resource
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest
from made_up_results import write_full

from uav_vslam.simulation.recording import record
from uav_vslam.simulation.scenario import SCENARIOS

ROOM_BYTES = 60_000
MAPS = ("geojson", "kml")


def limited(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
    """Run the command with that much room for each file."""
    command = [sys.executable, "-m", "uav_vslam.cli.main", *map(str, arguments)]
    return subprocess.run(
        command,
        capture_output=True,
        text=True,
        env=os.environ | {"PYTHONDONTWRITEBYTECODE": "1", "MPLCONFIGDIR": tempfile.gettempdir()},  # no cut caches
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (ROOM_BYTES, ROOM_BYTES)),
    )


def only_line(done: subprocess.CompletedProcess[str]) -> str:
    assert (done.returncode, done.stderr.count("\n")) == (1, 1), done.stderr
    assert done.stderr.startswith("uav-vslam: ")
    return done.stderr


@pytest.mark.slow
@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_simulate_names_the_bag_and_removes_it(storage: str, tmp_path: Path) -> None:
    bag = tmp_path / "flight"
    line = only_line(limited("simulate", bag, "--frames", "3", "--scale", "0.125", "--storage", storage))
    assert f"{bag}: " in line
    assert "make room" in line
    assert not bag.exists()


@pytest.mark.parametrize("options", [["csv"], ["tum"], ["kitti"], *([name, "--datum", "1", "2", "3"] for name in MAPS)])
def test_export_leaves_no_half_file(options: list[str], tmp_path: Path) -> None:
    track = tmp_path / "track.txt"
    track.write_text("".join(f"{0.1 * k:.1f} {k} {0.5 * k} 0 0 0 0 1\n" for k in range(4000)))
    line = only_line(limited("export", track, "--out", tmp_path / "out", "--format", *options))
    assert f"{tmp_path / 'out' / 'track'}" in line
    assert "make room" in line
    assert [path.name for path in (tmp_path / "out").iterdir() if path.stat().st_size >= ROOM_BYTES] == []
    assert not list((tmp_path / "out").glob("*.partial"))


def test_report_leaves_the_page_that_was_there(tmp_path: Path) -> None:
    folder, page = write_full(tmp_path / "results"), tmp_path / "page.html"
    page.write_text("before")
    assert f"{page}: " in only_line(limited("report", folder, "--output", page))
    assert page.read_text() == "before"
    assert not list(tmp_path.glob("*.partial"))


@pytest.mark.slow
def test_run_prints_its_table_first(tmp_path: Path) -> None:
    flight, results = tmp_path / "flight", tmp_path / "results"
    record(dataclasses.replace(SCENARIOS["kagaru"], vehicles=1, frames=8, scale=0.125, seed=3), flight)
    done = limited("run", flight, "--results", results)
    line = only_line(done)
    assert str(results) in line
    assert line.count("incomplete") == 1
    assert "S-SLAM" in done.stdout
    assert not (results / "latest").exists()
