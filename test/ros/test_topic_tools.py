# SPDX-License-Identifier: Apache-2.0
"""Messages as `uav-vslam topic echo` prints them, and its arguments."""

import pytest

pytest.importorskip("rclpy", reason="needs ROS")
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from sensor_msgs.msg import CameraInfo
from std_msgs.msg import ByteMultiArray

from uav_vslam.cli.main import main
from uav_vslam.ros.topic_tools import format_message
from uav_vslam_msgs.msg import LandmarkInformation


def test_arrays_of_a_fixed_size_are_printed_as_numbers() -> None:
    assert "origin: [1, -2, 3]" in format_message(LandmarkInformation(origin=[1, -2, 3]))
    assert "k: [0.5, 0, 0, 0, 0, 0, 0, 0] ... 9 in all" in format_message(CameraInfo(k=[0.5, *[0.0] * 8]))


def test_arrays_of_bytes_are_printed() -> None:
    assert format_message(ByteMultiArray(data=[b"\x01", b"a"]))[-1] == r"data: [b'\x01', b'a']"


def test_messages_in_an_array_are_indented_below_a_dash() -> None:
    lines = format_message(DiagnosticArray(status=[DiagnosticStatus(name="one"), DiagnosticStatus(name="two")]))
    start = lines.index("status:")
    assert lines[start + 1] == "-"
    assert [line for line in lines if "name:" in line] == ["  name: 'one'", "  name: 'two'"]


@pytest.mark.parametrize("action", ["echo", "hz"])
def test_a_negative_count_is_refused(action: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="2"):
        main(["topic", action, "/uav1/odometry", "--count=-1"])
    assert "'-1' is not a whole number of at least 0" in capsys.readouterr().err
