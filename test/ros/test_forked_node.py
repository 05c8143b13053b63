# SPDX-License-Identifier: Apache-2.0
"""A forked node is a process of its own in every way but its memory."""

import signal
import sys

import pytest

from uav_vslam.errors import ConfigError
from uav_vslam.ros.forked_node import ForkedNode
from uav_vslam.ros.supervisor import Command, Supervisor

EXAMPLE = "forked_example"


def ended(node: ForkedNode) -> tuple[int | None, str]:
    """Return its exit code and all output."""
    output = b"".join(iter(lambda: node.stdout.read(4096), b"")).decode()
    node.stdout.close()
    while node.poll() is None:
        pass
    return node.poll(), output


def test_it_has_a_group_title_environment_and_files_of_its_own_and_leaves_nothing() -> None:
    before = signal.signal(signal.SIGTERM, lambda *_: None)
    try:
        code, output = ended(ForkedNode(EXAMPLE, ["--ros-args", "-r", "__ns:=/uav1", "3"], {"EXAMPLE": "given"}))
    finally:
        signal.signal(signal.SIGTERM, before)
    assert code == 3
    title = f"{EXAMPLE} --ros-args -r __ns:=/uav1 3"
    told = f"{EXAMPLE} True {title} given [0, 1, 2] 4 False"  # 4: with the listing's
    assert output.splitlines() == [told, "to stderr", "destroyed"]


def test_a_signal_that_kills_it_is_its_exit_code() -> None:
    assert ended(ForkedNode(EXAMPLE, ["kill"], {}))[0] == -signal.SIGKILL


def test_an_error_is_told_and_never_reaches_the_supervisors_code() -> None:
    code, output = ended(ForkedNode(EXAMPLE, ["no number"], {}))
    assert code == 1
    assert "ValueError: invalid literal for int()" in output


@pytest.mark.parametrize(("forks", "runs"), [(True, EXAMPLE), (False, "the program")])
def test_the_supervisor_forks_nodes_if_it_may(forks: bool, runs: str, capfd: pytest.CaptureFixture[str]) -> None:
    program = [sys.executable, "-c", "print('the program')"]
    assert Supervisor(forks=forks).run([Command("uav1/x", program, leads=True, node=(EXAMPLE, "0"))]) == 0
    assert capfd.readouterr().out.startswith(f"[uav1/x] {runs}")


def test_a_node_whose_libraries_are_missing_is_refused_in_one_line() -> None:
    with pytest.raises(ConfigError, match="uav1/x can't be started: No module named 'missing'; is the ROS env"):
        Supervisor(forks=True).run([Command("uav1/x", [], node=("missing",))])
