# SPDX-License-Identifier: Apache-2.0
"""A reader that goes away, or has no such character, costs what it would have read, not the results."""

import dataclasses
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from uav_vslam.cli.main import BROKEN_PIPE
from uav_vslam.datasets.bag_recorder import RawRecorder
from uav_vslam.datasets.cdr import encode
from uav_vslam.datasets.message_builders import truth_message
from uav_vslam.datasets.messages import TruthSample
from uav_vslam.geometry.pose import Pose
from uav_vslam.simulation.recording import record
from uav_vslam.simulation.scenario import SCENARIOS


def check_saved_unread(results: Path, *arguments: str, saved: str = "latest/summary.json") -> None:
    """Run the command with a standard output that nobody reads; check its exit code, and that it has left results."""
    command = [sys.executable, "-m", "uav_vslam.cli.main", *arguments, "--no-plots", "--results", str(results)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    assert process.stdout is not None
    process.stdout.close()
    _, said = process.communicate()
    assert b"Traceback" not in said
    assert len(list(results.glob(saved))) == 1, said.decode()
    assert process.returncode == BROKEN_PIPE


@pytest.mark.slow
def test_a_run_whose_table_nobody_reads_is_saved(tmp_path: Path) -> None:
    bag, results = tmp_path / "flight", tmp_path / "results"
    record(dataclasses.replace(SCENARIOS["kagaru"], vehicles=1, frames=4, scale=0.125, seed=3), bag)
    check_saved_unread(results, "run", str(bag), "--no-maps", "--no-smoothing", "--workers", "1")


@pytest.mark.slow
def test_an_evaluation_whose_table_nobody_reads_is_saved(tmp_path: Path) -> None:
    bag, results = tmp_path / "estimates", tmp_path / "results"
    with RawRecorder(bag) as recorder:
        for k in range(3):
            sample = TruthSample(10**9 * (k + 1), Pose.identity(), np.zeros(3), np.zeros(3))
            data = encode(truth_message(sample, "uav1"))
            recorder.write("/uav1/odometry", "nav_msgs/msg/Odometry", data, sample.stamp_ns)
    check_saved_unread(results, "evaluate", str(bag))


@pytest.mark.slow
def test_findings_that_nobody_reads_are_in_their_file(tmp_path: Path) -> None:
    bag, findings = tmp_path / "flight", tmp_path / "check.json"
    record(dataclasses.replace(SCENARIOS["kagaru"], vehicles=1, frames=4, scale=0.125, seed=3), bag)
    command = [sys.executable, "-m", "uav_vslam.cli.main", "check", str(bag), "--json", str(findings)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    assert process.stdout is not None
    process.stdout.close()
    process.communicate()
    assert process.returncode == BROKEN_PIPE
    assert "vehicles" in json.loads(findings.read_text())


def test_a_comparison_whose_table_nobody_reads_is_saved(tmp_path: Path) -> None:
    track, results = tmp_path / "track.tum", tmp_path / "results"
    track.write_text("".join(f"{0.1 * k} {k} {0.5 * k} 0 0 0 0 1\n" for k in range(20)))
    check_saved_unread(results, "evaluate", str(track), "--truth", str(track), saved="*/comparison.json")


def test_a_terminal_without_a_character_shows_the_rest_of_the_table(tmp_path: Path) -> None:
    track = tmp_path / "track.tum"
    track.write_text("".join(f"{0.1 * k} {k} {0.5 * k} 0 0 0 0 1\n" for k in range(20)))
    options = ["evaluate", str(track), "--truth", str(track), "--no-plots", "--results", str(tmp_path / "results")]
    command = [sys.executable, "-m", "uav_vslam.cli.main", *options]
    environment = {**os.environ, "PYTHONIOENCODING": "latin-1"}
    done = subprocess.run(command, env=environment, capture_output=True, check=True)
    assert "written to" in done.stdout.decode("latin-1")
