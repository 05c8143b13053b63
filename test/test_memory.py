# SPDX-License-Identifier: Apache-2.0
"""An array as large as one that was freed takes its memory, without page faults."""

import subprocess
import sys

import pytest

PROGRAM = """
import resource
import sys
import numpy as np
from uav_vslam.memory import keep_freed_memory

if sys.argv[1] == "kept":
    keep_freed_memory()
for count in range(20):
    if count == 10:
        before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    pair = [np.ones((600, 600)) for _ in range(10)]
    del pair
print((resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before) / 100)
"""
PAGES = 600 * 600 * 8 / 4096  # of an array


@pytest.mark.skipif(sys.platform != "linux", reason="glibc's malloc")
def test_a_freed_array_is_used_again_without_page_faults() -> None:
    def faults(condition: str) -> float:
        command = [sys.executable, "-c", PROGRAM, condition]
        return float(subprocess.run(command, check=True, capture_output=True, text=True).stdout)

    assert faults("returned") > 0.5 * PAGES  # otherwise there is nothing to gain
    assert faults("kept") < 0.05 * PAGES
