# SPDX-License-Identifier: Apache-2.0
"""A node shuts down cleanly at any time, and a real error is still reported."""

import os
import subprocess
import sys
import textwrap
from collections.abc import Callable

import pytest

pytestmark = pytest.mark.ros
Run = Callable[[str], subprocess.CompletedProcess[str]]

PROGRAM = """
    import os, signal, sys
    from rclpy.node import Node
    from std_msgs.msg import String
    from uav_vslam.errors import ConfigError
    from uav_vslam.ros.runtime import run_node

    def factory():
        node = Node("unlucky")
        {act}
        node.create_publisher(String, "said", 10)
        return node

    sys.exit(run_node(factory))
"""


@pytest.fixture
def run(domain_id: int) -> Run:
    """Return what runs the program with an act of one's own in it, as a process."""
    environment = os.environ | {"ROS_DOMAIN_ID": str(domain_id)}

    def do(act: str) -> subprocess.CompletedProcess[str]:
        body = textwrap.indent(textwrap.dedent(act).strip(), " " * 8).lstrip()
        program = textwrap.dedent(PROGRAM.format(act=body))
        return subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, env=environment)

    return do


@pytest.mark.parametrize("number", ["SIGINT", "SIGTERM"])
def test_a_signal_while_a_node_is_still_being_made_ends_it_without_a_traceback(run: Run, number: str) -> None:
    done = run(f"os.kill(os.getpid(), signal.{number})")
    assert (done.returncode, done.stderr) == (0, "")


def test_a_signal_that_comes_while_rclpy_holds_its_lock_ends_the_node_too(run: Run) -> None:
    done = run("""
        def interrupt():
            with node.context._lock:
                signal.raise_signal(signal.SIGINT)

        node.create_timer(0.01, interrupt)
    """)
    assert (done.returncode, done.stderr) == (0, "")


def test_an_error_of_ours_is_one_line_and_exit_code_2(run: Run) -> None:
    done = run("raise ConfigError('epoch_s = -1 is not allowed')")
    assert (done.returncode, done.stderr) == (2, "uav_vslam: epoch_s = -1 is not allowed\n")


def test_an_error_of_ros_keeps_its_traceback(run: Run) -> None:
    done = run("node.destroy_node()")
    assert done.returncode == 1
    assert "Traceback" in done.stderr
