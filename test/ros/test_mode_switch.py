# SPDX-License-Identifier: Apache-2.0
"""The communication mode of a flying vehicle, by a command that needs no ROS installation."""

import os
import subprocess
import sys
import threading
from collections.abc import Iterator

import pytest

pytest.importorskip("rclpy", reason="needs ROS")
from command import refused
from rcl_interfaces.msg import ParameterType, ParameterValue
from rcl_interfaces.srv import GetParameters
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from sensor_msgs.msg import Imu

from uav_vslam.cli.arguments import MODES
from uav_vslam.cli.main import main
from uav_vslam.config.fusion import MODE_BUDGETS
from uav_vslam.errors import UavVslamError
from uav_vslam.ros.mode_switch import current_mode, switch_mode
from uav_vslam.ros.qos import NEWEST
from uav_vslam.ros.topic_tools import observer, print_rate

pytestmark = pytest.mark.ros


@pytest.fixture
def fusion(domain_id: int) -> Iterator[int]:
    """Run uav2's fusion node as a process, and return its ROS domain."""
    command = [sys.executable, "-m", "uav_vslam.ros.fusion_node", "--ros-args", "-r", "__ns:=/uav2"]
    with subprocess.Popen(
        command, env=os.environ | {"ROS_DOMAIN_ID": str(domain_id)}, stderr=subprocess.DEVNULL
    ) as node:
        yield domain_id
        node.terminate()


def test_the_mode_is_read_and_switched_by_a_typed_command(fusion: int, capfd: pytest.CaptureFixture[str]) -> None:
    domain = ["--domain", str(fusion), "--wait", "60"]
    assert main(["mode", "uav2", *domain]) == 0
    assert main(["mode", "uav2", "none", *domain]) == 0
    assert main(["mode", "uav2", *domain]) == 0
    assert capfd.readouterr().out.splitlines() == ["uav2: wideband", "uav2: none", "uav2: none"]
    with observer(fusion) as node, pytest.raises(UavVslamError, match="uav2 keeps its mode"):
        switch_mode(node, "uav2", "loud", wait_s=60.0)


def test_a_node_that_drops_its_first_answer_is_asked_again(domain_id: int, listener: Node) -> None:
    """As one on a busy machine does that has not discovered the asking one yet."""
    asked = []

    def answer(request: GetParameters.Request, response: GetParameters.Response) -> GetParameters.Response:
        asked.append(request)
        response.values = [ParameterValue(type=ParameterType.PARAMETER_STRING, string_value="wideband")]
        return response

    service = listener.create_service(GetParameters, "/uav2/fusion/get_parameters", answer)
    send = service.send_response
    service.send_response = lambda *response: send(*response) if len(asked) > 1 else None
    executor = SingleThreadedExecutor(context=listener.context)
    executor.add_node(listener)
    serving = threading.Thread(target=executor.spin)
    serving.start()
    try:
        with observer(domain_id) as node:
            assert current_mode(node, "uav2", wait_s=60.0) == "wideband"
    finally:
        executor.shutdown()
        serving.join()
    assert len(asked) > 1


def test_a_vehicle_may_be_in_a_namespace_of_a_fleet(domain_id: int, capfd: pytest.CaptureFixture[str]) -> None:
    command = [sys.executable, "-m", "uav_vslam.ros.fusion_node", "--ros-args", "-r", "__ns:=/fleet/uav2"]
    environment = os.environ | {"ROS_DOMAIN_ID": str(domain_id)}
    with subprocess.Popen(command, env=environment, stderr=subprocess.DEVNULL) as node:
        assert main(["mode", "/fleet/uav2", "narrowband", "--domain", str(domain_id), "--wait", "60"]) == 0
        node.terminate()
    assert capfd.readouterr().out == "fleet/uav2: narrowband\n"


def test_an_unknown_mode_is_refused_before_the_vehicle_is_looked_for(capsys: pytest.CaptureFixture[str]) -> None:
    assert set(MODES) == set(MODE_BUDGETS)
    with pytest.raises(SystemExit, match="2"):
        main(["mode", "uav2", "loud"])
    assert "choose from" in capsys.readouterr().err


def test_a_vehicle_that_is_not_there_is_named(domain_id: int, capfd: pytest.CaptureFixture[str]) -> None:
    assert main(["mode", "uav9", "none", "--domain", str(domain_id), "--wait", "0.5"]) == 2
    assert "is uav9 flying" in capfd.readouterr().err


@pytest.mark.parametrize(("vehicle", "wait"), [("a b", "1"), ("/", "1"), ("uav1", "nan"), ("uav1", "-1")])
def test_a_name_or_a_time_that_cannot_be_is_refused(
    vehicle: str, wait: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit, match="2"):
        main(["mode", vehicle, f"--wait={wait}"])
    assert "is no ROS namespace" in (error := capsys.readouterr().err) or "is not a time in seconds above 0" in error


@pytest.mark.parametrize("topic", ["/a b", "/", "a//b", "/1x"])
@pytest.mark.parametrize("action", ["echo", "hz"])
def test_a_name_that_no_topic_can_have_is_refused_in_one_line(
    action: str, topic: str, domain_id: int, capsys: pytest.CaptureFixture[str]
) -> None:
    error = refused(capsys, "topic", action, topic, "--wait", "0.1", "--domain", str(domain_id))
    assert f"{topic!r} is no topic: topic name must not" in error


def test_the_rate_of_a_stream_that_has_stopped_is_zero(domain_id: int, capsys: pytest.CaptureFixture[str]) -> None:
    """Those of a latched topic that were sent before come all at once."""
    with observer(domain_id) as node:
        sender = node.create_publisher(Imu, "/uav1/imu", NEWEST)
        for _ in range(10):
            sender.publish(Imu())
        print_rate(node, "/uav1/imu", wait_s=10.0, count=2)
    assert capsys.readouterr().out == 2 * "0.00 Hz, 0.00 kB/s\n"
