# SPDX-License-Identifier: Apache-2.0
"""A node shuts down cleanly at any time, and a real error is still reported."""

import os
import signal
import subprocess
import sys
import textwrap
from collections.abc import Callable
from pathlib import Path

import pytest

from uav_vslam.config.nodes import NODES
from uav_vslam.ros.command import find_executable
from uav_vslam.ros.leaving import LEFT
from waiting import wait_for

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


@pytest.mark.usefixtures("hangup")
@pytest.mark.parametrize("number", ["SIGINT", "SIGTERM", "SIGHUP"])
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


STAYS = """
    import ctypes
    node.destroy_node = lambda: ctypes.PyDLL(None).sleep(60)  # it keeps the interpreter's lock, as Fast DDS does
    def end():
        raise SystemExit({code})
    node.create_timer(0.01, end)
"""


def test_a_node_that_can_not_leave_its_domain_is_ended_from_outside(run: Run) -> None:
    assert run(STAYS.format(code=0)).returncode == -LEFT
    failed = run(STAYS.format(code=3))
    assert failed.returncode == 1
    assert "in run_node" in failed.stderr  # where it was


def handles(pid: int, number: signal.Signals) -> bool:
    """Return whether a process has a handler for the signal."""
    lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    caught = next(int(line.split()[1], 16) for line in lines if line.startswith("SigCgt:"))
    return bool(caught >> (number - 1) & 1)


def test_ctrl_c_while_a_node_is_still_importing_ends_it_without_a_traceback(domain_id: int) -> None:
    (program,) = find_executable("slam_backend")
    command = [program, "--ros-args", "-r", "__ns:=/uav1"]
    environment = os.environ | {"ROS_DOMAIN_ID": str(domain_id)}
    with subprocess.Popen(command, env=environment, stderr=subprocess.PIPE, text=True) as node:
        for expected in (True, False):  # of Python's start, then of the program's
            assert wait_for(lambda expected=expected: handles(node.pid, signal.SIGINT) is expected, lambda: None)
        node.send_signal(signal.SIGINT)
        assert node.communicate()[1] == ""
        assert node.returncode == -signal.SIGINT


PROGRAM_OF_A_NODE = """
    import gc, sys
    from uav_vslam.ros.start import main

    sys.argv[:] = ["recorder", "--ros-args", "--params-file", "/nowhere.yaml"]
    print(main(), gc.isenabled(), gc.get_freeze_count() > 100 * len(gc.get_objects()))
"""


def test_the_end_of_a_program_does_not_search_its_libraries_for_garbage() -> None:
    """That took longer than all else of a node's shut-down."""
    command = [sys.executable, "-c", textwrap.dedent(PROGRAM_OF_A_NODE)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert done.stdout == "2 True True\n"


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--params-file", "/nowhere.yaml"], "Couldn't parse params file: '--params-file /nowhere.yaml'"),
        (["-p", "peers:=[uav2, 3]"], "Value type 'integer' do not belong"),
        (["-p", "use_sim_time:=1"], "'use_sim_time' to '1' of type 'INTEGER', expecting type 'BOOL'"),
        (["-p", "qos_overrides./uav1/odometry.publisher.depth:=-1"], "use a whole number of at least 1"),
        (["-p", "qos_overrides./uav1/odometry.publisher.reliability:=safe"], "system_default, reliable, best_effort"),
    ],
)
def test_what_ros_refuses_is_one_line_too(run: Run, arguments: list[str], said: str) -> None:
    command = [*find_executable("slam_backend"), "--ros-args", "-r", "__ns:=/uav1", *arguments]
    done = subprocess.run(command, capture_output=True, text=True)
    assert (done.returncode, done.stderr.count("\n")) == (2, 1), done.stderr
    assert done.stderr.startswith("uav_vslam: ")
    assert said in done.stderr
    assert ".c:" not in done.stderr


def test_an_argument_that_is_none_of_ros_is_refused_and_not_ignored() -> None:
    command = [*find_executable("slam_backend"), "-p", "backend.sigma_px:=0.5", "--ros-args", "-r", "__ns:=/uav1"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60)
    said = "uav_vslam: unknown argument -p: those of ROS follow --ros-args (--help)\n"
    assert (done.returncode, done.stderr) == (2, said)


@pytest.mark.parametrize("name", [*NODES])
def test_help_names_the_arguments_and_the_topics(name: str) -> None:
    done = subprocess.run([*find_executable(name), "--help"], capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stderr) == (0, "")
    usage, _, about, *_ = done.stdout.splitlines()
    assert (usage.startswith("usage: "), about.startswith(f"{name}: ")) == (True, True)


@pytest.mark.parametrize(
    ("node", "arguments", "said"),
    [
        ("stereo_frontend", ["-p", "input.topics.left:=/cam-0/image"], "'/cam-0/image'"),
        ("fusion", ["-p", "peers:=['uav 2']"], "topic name must not contain characters other than alphanumerics"),
        ("recorder", ["-p", "output:=bag", "-p", "vehicles:=['uav-1']"], "'/uav-1/"),
    ],
)
def test_a_topic_that_can_not_be_is_one_line(node: str, arguments: list[str], said: str, tmp_path: Path) -> None:
    command = [*find_executable(node), "--ros-args", "-r", "__ns:=/uav1", *arguments]
    done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path)
    assert done.returncode == 2, done.stderr
    (line,) = [line for line in done.stderr.splitlines() if not line.startswith("[INFO]")]
    assert (line.startswith("uav_vslam: "), said in line, "; correct the " in line) == (True, True, True)


@pytest.mark.parametrize(
    ("node", "arguments", "said"),
    [
        ("fusion", ["peers:=[uav2, uav2]"], "peers = ['uav2', 'uav2'] is not allowed; use each name once"),
        ("recorder", ["output:=bag", "vehicles:=[uav1, uav1]"], "vehicles = ['uav1', 'uav1'] is not allowed"),
        ("link_emulator", ["vehicles:=[uav1, uav1]"], "vehicles = ['uav1', 'uav1'] is not allowed"),
        ("replay", ["vehicles:=[uav1, uav1]"], "vehicles = ['uav1', 'uav1'] is not allowed"),
    ],
)
def test_vehicles_that_are_named_twice_are_one_line(node: str, arguments: list[str], said: str, tmp_path: Path) -> None:
    command = [*find_executable(node), "--ros-args", "-r", "__ns:=/uav1"]
    for argument in arguments:
        command += ["-p", argument]
    try:
        done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, timeout=60)
    except subprocess.TimeoutExpired:
        pytest.fail("it runs")
    assert (done.returncode, done.stderr.count("\n")) == (2, 1), done.stderr
    assert said in done.stderr
    assert not (tmp_path / "bag").exists()


@pytest.mark.parametrize("node", ["slam_backend", "fusion"])
def test_a_vehicle_whose_name_is_no_namespace_is_one_line_with_the_reason(node: str) -> None:
    command = [*find_executable(node), "--ros-args", "-r", "__ns:=/uav1"]
    done = subprocess.run([*command, "-p", "vehicle:=a/b"], capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stderr.count("\n")) == (2, 1), done.stderr
    assert "vehicle = 'a/b' is not allowed; use a valid ROS namespace" in done.stderr
