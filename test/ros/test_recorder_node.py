# SPDX-License-Identifier: Apache-2.0
"""The recorder says where it can't record, and when a vehicle whose nodes are there is no longer heard."""

import contextlib
import os
import subprocess
import sys
from pathlib import Path

import pytest

rclpy = pytest.importorskip("rclpy", reason="needs ROS")
from lone_node import lone_node  # noqa: E402
from nav_msgs.msg import Odometry  # noqa: E402
from node_processes import Witness, running  # noqa: E402
from rclpy.executors import SingleThreadedExecutor  # noqa: E402
from rclpy.qos import qos_profile_sensor_data  # noqa: E402

from uav_vslam.datasets.unindexed_mcap import readable_messages  # noqa: E402
from uav_vslam.ros import recorder_node  # noqa: E402
from uav_vslam.ros.fleet_commands import NodeSpec  # noqa: E402

pytestmark = pytest.mark.ros

RECORDER = "fleet: recorder"


def test_a_vehicle_that_is_no_longer_heard_is_named(
    domain_id: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(recorder_node, "SILENCE_S", 1.0)
    message = Odometry()
    message.header.stamp.sec = 1

    with lone_node(recorder_node.RecorderNode, domain_id) as made, Witness(domain_id) as witness:
        recorder = made(f"output:={tmp_path / 'out'}", "vehicles:=[uav1, uav2]")
        executor = SingleThreadedExecutor()
        executor.add_node(recorder)
        try:
            first, second = (
                witness.node.create_publisher(Odometry, f"/{name}/odometry", 10) for name in ("uav1", "uav2")
            )

            def both() -> None:
                first.publish(message)
                second.publish(message)
                executor.spin_once(timeout_sec=0.01)

            def second_only() -> None:
                second.publish(message)
                executor.spin_once(timeout_sec=0.01)

            assert witness.sees(lambda: int(witness.value(RECORDER, "written") or 0) > 20, both)
            assert witness.text(RECORDER) == "recording"
            assert witness.sees(lambda: "nothing comes from uav1 for" in witness.text(RECORDER), second_only)
            assert "uav2" not in witness.text(RECORDER)
            assert witness.sees(lambda: witness.text(RECORDER) == "recording", both)
        finally:
            executor.shutdown()


def test_best_effort_publishers_are_recorded_too(domain_id: int, tmp_path: Path) -> None:
    """As bridges of motion capture and autopilots publish the ground truth."""
    message = Odometry()
    message.header.stamp.sec = 1
    with lone_node(recorder_node.RecorderNode, domain_id) as made, Witness(domain_id) as witness:
        recorder = made(f"output:={tmp_path / 'out'}", "vehicles:=[uav1]")
        executor = SingleThreadedExecutor()
        executor.add_node(recorder)
        publisher = witness.node.create_publisher(Odometry, "/uav1/ground_truth/odometry", qos_profile_sensor_data)

        def publish() -> None:
            publisher.publish(message)
            executor.spin_once(timeout_sec=0.01)

        try:
            assert witness.sees(lambda: "uav1" in recorder._newest_s, publish)
        finally:
            executor.shutdown()


def test_an_output_in_a_place_where_nothing_can_be_made_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "disk").write_text("a file, no folder")
    output, environment = tmp_path / "disk" / "flights" / "1", os.environ | {"HOME": str(tmp_path)}
    command = [sys.executable, "-m", "uav_vslam.ros.recorder_node", "--ros-args", "-p", "vehicles:=[uav1]"]
    given = [*command, "-p", "output:=~/disk/flights/1"]  # no shell expands ~ after `:=`
    done = subprocess.run(given, capture_output=True, text=True, env=environment)
    assert (done.returncode, done.stderr.count("\n")) == (2, 1), done.stderr
    assert f"{output}: can't be made" in done.stderr


def test_a_recorder_that_is_killed_loses_no_more_than_what_came_since_its_last_report(
    domain_id: int, tmp_path: Path
) -> None:
    spec = NodeSpec("recorder", "/", {"output": str(tmp_path / "out"), "vehicles": ["uav1"]})
    message, file = Odometry(), tmp_path / "out" / "out.mcap"
    with Witness(domain_id) as witness, running([spec], tmp_path, domain_id) as processes:
        publisher = witness.node.create_publisher(Odometry, "/uav1/odometry", 10)

        def publish() -> None:
            message.header.stamp.sec += 1
            publisher.publish(message)

        assert witness.sees(lambda: int(witness.value(RECORDER, "written") or 0) > 20, publish)
        written = int(witness.value(RECORDER, "written"))
        processes["recorder"].kill()
        processes["recorder"].wait()
    found = 0
    with contextlib.suppress(EOFError):
        for _ in readable_messages(file):
            found += 1
    assert found >= written
