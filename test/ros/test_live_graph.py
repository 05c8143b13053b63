# SPDX-License-Identifier: Apache-2.0
"""The node graph from the user's side: own nodes receive its topics, it reports what it waits for, Ctrl-C ends it."""

import os
import shlex
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import pytest

rclpy = pytest.importorskip("rclpy", reason="needs ROS")
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus  # noqa: E402
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue  # noqa: E402
from rcl_interfaces.srv import SetParameters  # noqa: E402
from rclpy.executors import SingleThreadedExecutor  # noqa: E402

from uav_vslam.ros.fleet_commands import VEHICLE_NODES  # noqa: E402
from uav_vslam_msgs.msg import FusionStatus, LandmarkInformation  # noqa: E402
from waiting import wait_for  # noqa: E402

pytestmark = pytest.mark.ros

ROOT = Path(__file__).parents[2]

LISTENER = """
import rclpy
from nav_msgs.msg import Odometry
from uav_vslam_msgs.msg import LandmarkInformation

rclpy.init()
node = rclpy.create_node("mine")
received = {}
for topic, kind in (("/uav1/odometry", Odometry), ("/uav1/landmark_information", LandmarkInformation)):
    node.create_subscription(kind, topic, lambda message, topic=topic: received.setdefault(topic, message), 10)
while len(received) < 2:
    rclpy.spin_once(node)
print(received["/uav1/odometry"].header.frame_id, received["/uav1/odometry"].child_frame_id)
print(received["/uav1/landmark_information"].vehicle, len(received["/uav1/landmark_information"].ids) > 0)
"""


def in_a_fresh_shell(program: str, domain_id: int) -> list[str]:
    """Return the command that runs a Python program as a user would, with nothing but env.sh sourced."""
    script = f". {shlex.quote(str(ROOT / 'env.sh'))} && exec python -c {shlex.quote(program)}"
    home = f"HOME={os.environ.get('HOME', '/')}"
    return ["env", "-i", "PATH=/usr/bin:/bin", home, f"ROS_DOMAIN_ID={domain_id}", "bash", "-c", script]


@pytest.fixture(scope="module")
def graph(
    launched: Callable[..., AbstractContextManager[Any]], tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Any]:
    """Two vehicles that fly over an emulated radio; the last test ends them."""
    slow = ["--rate", "0.2"]  # the flight outlasts the tests, whatever the machine's speed
    arguments = [*slow, "--link", "clean", "--log-dir", str(tmp_path_factory.mktemp("log"))]
    with launched(str(ROOT / "config" / "fleet_demo.yaml"), *arguments) as started:
        yield started


@pytest.mark.slow
def test_a_healthy_start_is_ok_and_nothing_on_diagnostics_serves_the_replay(graph: Any) -> None:
    said: dict[str, DiagnosticStatus] = {}

    def flies(status: DiagnosticStatus) -> bool:
        assert "unmatched" not in {entry.key for entry in status.values}
        assert not (status.level != DiagnosticStatus.OK and "waiting" in status.message), status.message
        said[status.name] = status
        return sum(one.message == "running" for one in said.values()) == len(VEHICLE_NODES) * 2

    diagnostics_until(graph.domain_id, flies, graph.alive)
    assert {status.hardware_id for status in said.values()} == {"uav1", "uav2", ""}


@pytest.mark.slow
def test_a_users_own_node_receives_the_topics(graph: Any) -> None:
    received = subprocess.run(in_a_fresh_shell(LISTENER, graph.domain_id), capture_output=True, text=True)
    assert received.stdout.splitlines() == ["uav1/map uav1/base_link", "uav1 True"], received.stderr


@pytest.mark.slow
def test_over_an_emulated_link_packets_pass_and_the_mode_is_switched_in_flight(graph: Any) -> None:
    received: list[LandmarkInformation] = []
    modes: list[str] = []
    context = rclpy.Context()
    context.init(domain_id=graph.domain_id)
    node = rclpy.create_node("pilot", context=context)
    node.create_subscription(LandmarkInformation, "/uav1/received/uav2", received.append, 10)
    node.create_subscription(FusionStatus, "/uav1/fusion/status", lambda status: modes.append(status.mode), 10)
    client = node.create_client(SetParameters, "/uav1/fusion/set_parameters")
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)

    def spin(until: Callable[[], Any]) -> bool:
        return wait_for(until, lambda: executor.spin_once(timeout_sec=0.02), alive=graph.alive)

    try:
        assert spin(lambda: received and modes)
        assert (received[0].vehicle, modes[-1]) == ("uav2", "wideband")
        assert spin(client.service_is_ready)
        value = ParameterValue(type=ParameterType.PARAMETER_STRING, string_value="narrowband")
        request = SetParameters.Request(parameters=[Parameter(name="fusion.mode", value=value)])
        answer = client.call_async(request)
        assert spin(answer.done)
        assert [result.successful for result in answer.result().results] == [True]
        assert spin(lambda: modes[-1] == "narrowband")
    finally:
        node.destroy_node()
        context.try_shutdown()


@pytest.mark.slow
def test_ctrl_c_ends_all_of_the_graph(graph: Any) -> None:
    assert wait_for(
        lambda: len(graph.running()) == 11, alive=graph.alive
    )  # the launcher, four nodes a vehicle, the link, the replay
    graph.process.send_signal(signal.SIGINT)
    output, _ = graph.process.communicate()
    assert graph.running() == []
    assert graph.process.returncode == 128 + signal.SIGINT
    assert "Traceback" not in output
    assert "waiting for" not in output


def diagnostics_until(domain_id: int, done: Callable[[DiagnosticStatus], bool], alive: Callable[[], bool]) -> list[str]:
    """Return the texts on /diagnostics up to the requested one."""
    texts: list[str] = []
    found: list[None] = []

    def note(message: DiagnosticArray) -> None:
        for status in message.status:
            texts.append(f"{status.name}: {status.message}")
            if done(status):
                found.append(None)

    context = rclpy.Context()
    context.init(domain_id=domain_id)
    node = rclpy.create_node("listener", context=context)
    node.create_subscription(DiagnosticArray, "/diagnostics", note, 10)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    wait_for(lambda: found, lambda: executor.spin_once(timeout_sec=0.02), alive=alive)
    node.destroy_node()
    context.try_shutdown()
    return texts


def test_a_node_reports_a_topic_without_publisher(domain_id: int) -> None:
    command = [sys.executable, "-m", "uav_vslam.ros.slam_backend_node", "--ros-args", "-r", "__ns:=/uav1"]
    node = subprocess.Popen(
        command, env=os.environ | {"ROS_DOMAIN_ID": str(domain_id)}, stderr=subprocess.PIPE, text=True
    )
    try:
        texts = diagnostics_until(domain_id, lambda s: s.level == DiagnosticStatus.WARN, lambda: node.poll() is None)
        assert texts[-1].startswith("uav1: slam_backend: waiting for ")
        awaited = {"left/camera_info", "right/camera_info", "/tf_static", "initial_state", "ins/increment"}
        assert awaited | {"stereo_features"} <= set(texts[-1].partition("waiting for ")[2].split(", "))
        assert node.stderr is not None
        said = next(line for line in node.stderr if "waiting for" in line)
        for topic in (*awaited - {"/tf_static"}, "stereo_features"):
            assert f"/uav1/{topic} (no publisher)" in said
        node.send_signal(signal.SIGINT)
        assert node.wait() == 0
    finally:
        node.kill()
        node.communicate()
