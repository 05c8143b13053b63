# SPDX-License-Identifier: Apache-2.0
"""`uav-vslam monitor`: what scripts rely on, and a clean end."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="needs ROS")
from command import refused

from uav_vslam.cli.main import main

ROOT = Path(__file__).parents[2]
FLEET = ROOT / "config" / "fleet_demo.yaml"

pytestmark = pytest.mark.ros


@pytest.mark.parametrize(
    ("who", "awaited"),
    [([], "waiting for a vehicle"), (["--vehicles", "b", "a"], "waiting for b, a"), ([str(FLEET)], "uav1, uav2")],
)
def test_once_on_an_empty_domain_says_what_is_awaited(
    who: list[str], awaited: str, domain_id: int, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["monitor", *who, "--once", "--wait", "0.1", "--domain", str(domain_id)]) == 1
    assert awaited in capsys.readouterr().out


def test_wrong_arguments_are_refused_in_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    for verb in (["monitor"], ["topic", "list"], ["mode", "uav1"]):
        assert "--domain 102 is not allowed" in refused(capsys, *verb, "--domain", "102")
    assert "nowhere.yaml" in refused(capsys, "monitor", "nowhere.yaml")


@pytest.mark.parametrize(
    ("option", "value", "message"),
    [
        ("--vehicles", "a b", "'a b' is no ROS namespace"),
        ("--every", "0", "'0' is not a time in seconds above 0"),
        ("--wait", "soon", "'soon' is not a time in seconds above 0"),
    ],
)
def test_a_name_or_time_that_can_not_be_is_refused(
    option: str, value: str, message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as leaving:
        main(["monitor", option, value, "--once"])
    assert leaving.value.code == 2
    assert message in capsys.readouterr().err


def test_ctrl_c_ends_it_without_a_traceback(domain_id: int) -> None:
    command = [sys.executable, "-m", "uav_vslam.cli.main", "monitor", "--every", "0.1", "--domain", str(domain_id)]
    with subprocess.Popen(
        command, env=os.environ, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        assert "waiting for a vehicle" in process.stdout.readline()
        process.send_signal(signal.SIGINT)
        _, error = process.communicate(timeout=60)
    assert (process.returncode, error) == (130, "")
