# SPDX-License-Identifier: Apache-2.0
"""Two vehicles as two computers (network namespaces), each started by its one command from the one fleet file.

Opt-in, as it needs root, two minutes and these tools: UAV_VSLAM_NETNS=1, `ip` and `tc` (tbf). Every node runs, on
images; a driver on each host stands for its cameras and IMU. The operator types the installed commands.
"""

import dataclasses
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from network_namespaces import Host, connected, unavailable

from uav_vslam.simulation.recording import record
from uav_vslam.simulation.scenario import SCENARIOS
from waiting import wait_for

pytestmark = [
    pytest.mark.ros,
    pytest.mark.slow,
    pytest.mark.skipif(bool(missing := unavailable("ip", "tc")), reason=missing or "available"),
]

FRAMES = 500  # 70 s
RATE_BIT = 2_000_000
FLEET = """
vehicles:
  uav1: {address: 10.77.0.1}
  uav2: {address: 10.77.0.2}
radio: {domain_id: 42, interface: INTERFACE}
mode: wideband
"""


@dataclass
class Computer:
    """One vehicle's computer: its launcher and its driver, with what they have said so far."""

    host: Host
    launcher: subprocess.Popen[bytes]
    driver: subprocess.Popen[str]
    folder: Path

    @property
    def peer(self) -> str:
        return "uav2" if self.host.index == 1 else "uav1"

    def notes(self, key: str) -> list[dict[str, Any]]:
        """Return the driver's notes that have the key."""
        file = self.folder / f"{self.host.vehicle}.json"
        lines = file.read_text().splitlines(keepends=True) if file.exists() else []
        return [note for line in lines if line.endswith("\n") and key in (note := json.loads(line))]

    def used(self) -> int:
        """Return how many of the peer's packets have been fused."""
        statuses = self.notes("mode")
        return statuses[-1]["used"].get(self.peer, 0) if statuses else 0

    def mode(self) -> str:
        statuses = self.notes("mode")
        return statuses[-1]["mode"] if statuses else ""

    def faults(self) -> str:
        """Return the newest text of the fusion node's diagnostics."""
        texts = [note["text"] for note in self.notes("text") if note["name"] == f"{self.host.vehicle}: fusion"]
        return texts[-1] if texts else ""

    def log(self) -> str:
        return (self.folder / f"{self.host.vehicle}.log").read_text()

    def command(self, *arguments: str) -> str:
        """Run the `uav-vslam` command on this computer, as its operator does."""
        done = subprocess.run(self.host.inside(*uav_vslam(self.host, *arguments)), capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        return done.stdout


def uav_vslam(host: Host, *arguments: str) -> list[str]:
    # Network namespaces share the memory through which the participants of one host and domain talk.
    return ["env", f"ROS_DOMAIN_ID={host.index}", sys.executable, "-m", "uav_vslam.cli.main", *arguments]


@pytest.fixture
def computers(tmp_path: Path) -> Iterator[list[Computer]]:
    flight = tmp_path / "flight"
    record(dataclasses.replace(SCENARIOS["kagaru"], vehicles=2, frames=FRAMES, scale=0.25, seed=1), flight)
    hosts, made = [Host(1), Host(2)], []
    with connected(hosts, rate_bit=RATE_BIT, burst_bytes=8000, queue_bytes=200_000):
        for host in hosts:
            made.append(start(host, flight, tmp_path))
        try:
            yield made
        finally:
            for process in (process for one in made for process in (one.launcher, one.driver)):
                process.kill()
                process.communicate()


def start(host: Host, flight: Path, folder: Path) -> Computer:
    fleet = folder / f"{host.vehicle}.yaml"  # the one fleet file, but for the name of the network interface
    fleet.write_text(FLEET.replace("INTERFACE", host.interface))
    launch = host.inside(*uav_vslam(host, "launch", str(fleet), "--vehicle", host.vehicle))
    driver = [sys.executable, str(Path(__file__).with_name("driver.py")), str(flight), host.vehicle]
    notes = str(folder / f"{host.vehicle}.json")
    with (folder / f"{host.vehicle}.log").open("wb") as log:
        launcher = subprocess.Popen(launch, stdout=log, stderr=log)
        environment = os.environ | {"ROS_DOMAIN_ID": str(host.index)}
        play = subprocess.Popen(
            host.inside(*driver, notes), env=environment, stdin=subprocess.PIPE, stdout=log, stderr=log, text=True
        )
    return Computer(host, launcher, play, folder)


def test_two_computers_cooperate_switch_the_mode_name_a_dead_radio_and_end_cleanly(computers: list[Computer]) -> None:
    first, second = computers

    def comes(condition: Callable[[], Any]) -> bool:
        flying = [process for one in computers for process in (one.launcher, one.driver)]
        return wait_for(condition, lambda: time.sleep(0.2), alive=lambda: all(p.poll() is None for p in flying))

    def uses(one: Computer, more: int) -> bool:
        before = one.used()
        return comes(lambda: one.used() >= before + more)

    assert comes(lambda: first.notes("ready") and second.notes("ready")), first.log() + second.log()
    for one in computers:
        assert one.driver.stdin is not None
        print(time.time() + 3.0, file=one.driver.stdin, flush=True)

    assert uses(first, 2), first.log()
    assert uses(second, 2), second.log()
    assert "uav1: narrowband" in first.command("mode", "uav1", "narrowband", "--wait", "30")
    assert comes(lambda: first.mode() == "narrowband")
    assert second.mode() == "wideband"
    assert uses(second, 3), "packets of the new mode are used by the peer"

    first.host.run("ip", "link", "set", first.host.interface, "down")
    assert comes(lambda: "radio interface radio1 is down" in first.faults() and "uav2 silent" in first.faults())
    assert comes(lambda: "uav1 silent" in second.faults())
    shown = first.command("monitor", "--vehicles", "uav1", "--once", "--wait", "30")  # it is announced every 20 s
    assert "radio interface radio1 is down" in " ".join(shown.split()), shown  # lines may be folded
    assert "[uav1.fusion]: radio interface radio1 is down" in first.log()
    assert "[uav2.fusion]: uav1 is silent" in second.log()

    for one in computers:
        one.launcher.send_signal(signal.SIGINT)
    assert [one.launcher.wait() for one in computers] == [0, 0]
    for one in computers:
        assert "Traceback" not in one.log()
        one.driver.terminate()
        one.driver.wait()
        assert subprocess.run(["ip", "netns", "pids", one.host.namespace], capture_output=True, text=True).stdout == ""
