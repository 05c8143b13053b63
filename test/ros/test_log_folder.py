# SPDX-License-Identifier: Apache-2.0
"""ROS wants to keep logs: what starts without a home, and what is said where they can't be kept."""

import os
import subprocess
import sys

import pytest

pytestmark = pytest.mark.ros

OBSERVER = """
from uav_vslam.ros.topic_tools import observer
with observer(None):
    print("observes")
"""
NODE = """
import sys
from uav_vslam.ros.runtime import run_node
def factory():
    print("observes")
    raise SystemExit(0)
sys.exit(run_node(factory))
"""
MONITOR = "import sys; from uav_vslam.cli.main import main; sys.exit(main(['monitor', '--once', '--wait', '0.1']))"


def run(program: str, domain_id: int, **changed: str | None) -> subprocess.CompletedProcess[str]:
    environment = os.environ | changed | {"ROS_DOMAIN_ID": str(domain_id), "ROS_LOG_DIR": None, "ROS_HOME": None}
    given = {name: value for name, value in environment.items() if value is not None}
    return subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, env=given)


@pytest.mark.parametrize("home", [None, ""])
@pytest.mark.parametrize("program", [OBSERVER, NODE])
def test_without_home_as_in_a_system_service_the_users_own_is_taken(
    program: str, home: str | None, domain_id: int
) -> None:
    done = run(program, domain_id, HOME=home)
    assert (done.returncode, done.stdout) == (0, "observes\n"), done.stderr


@pytest.mark.parametrize("program", [MONITOR, NODE])
def test_logs_that_cannot_be_kept_are_one_line_that_says_what_to_do(program: str, domain_id: int) -> None:
    done = run(program, domain_id, HOME="/dev/null/nowhere")
    assert done.returncode == 2
    *_, line = done.stderr.splitlines()
    assert "/dev/null/nowhere/.ros/log" in line
    assert line.endswith("; name a writable folder in ROS_LOG_DIR")
    assert "Traceback" not in done.stderr
