# SPDX-License-Identifier: Apache-2.0
"""A reader that goes away costs what it would have read, not the results."""

import subprocess
import sys
from pathlib import Path

import pytest

SAMPLE = Path(__file__).parents[2] / "bags" / "sample"


@pytest.mark.slow
def test_a_run_whose_table_nobody_reads_is_saved(tmp_path: Path) -> None:
    options = "--vehicles uav1 --config sample --no-plots --no-maps --no-smoothing --workers 1 --results"
    command = [sys.executable, "-m", "uav_vslam.cli.main", "run", str(SAMPLE), *options.split(), str(tmp_path)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    assert process.stdout is not None
    process.stdout.close()
    _, said = process.communicate()
    assert b"Traceback" not in said
    assert (tmp_path / "latest" / "summary.json").is_file(), said.decode()
