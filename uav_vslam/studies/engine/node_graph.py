# SPDX-License-Identifier: Apache-2.0
"""Flies a simulated fleet through the node graph: one process a node, over DDS, on a ROS domain of its own."""

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import yaml

from uav_vslam.datasets.flight_writer import ImageCoding
from uav_vslam.errors import UavVslamError
from uav_vslam.simulation.recording import record
from uav_vslam.simulation.scenario import Scenario

LAST_LINES = 5  # of a failed graph's output, for the error message

Launcher = subprocess.Popen[bytes]


def record_fleet(folder: Path, scenario: Scenario, config: Path, *, coding: str, rate: float) -> Path:
    """Record a flight into a folder and return the file of a fleet that replays it.

    Args:
        folder: of the recording, "flight", and of the fleet's file.
        scenario: the flight.
        config: of every vehicle.
        coding: of the images.
        rate: of the replay; 0 for lock-step.
    """
    record(scenario, folder / "flight", coding=ImageCoding(coding))
    vehicles = [scenario.vehicle_name(k) for k in range(scenario.vehicles)]
    tree = {
        "vehicles": {name: {"config": str(config.resolve())} for name in vehicles},
        "replay": {"bags": ["flight"], "rate": rate},
    }
    path = folder / "fleet.yaml"
    path.write_text(yaml.safe_dump(tree), encoding="utf-8")
    return path


def fly_graph(fleet: Path, mode: str, *, watch: Callable[[Launcher], None] = lambda _: None) -> Path:
    """Run the node graph over the fleet's flight to its end and return what it recorded.

    Args:
        fleet: file of the fleet.
        mode: how its vehicles communicate.
        watch: called with the launcher as soon as it runs.

    Raises:
        UavVslamError: a process failed.
    """
    from uav_vslam.ros.domain import claimed_domain

    estimates, log = fleet.parent / mode, fleet.parent / f"{mode}.log"
    command = [sys.executable, "-m", "uav_vslam.cli.main", "launch", str(fleet), "--mode", mode]
    command += ["--record", str(estimates)]
    with claimed_domain() as domain_id, log.open("wb") as stream:
        command += ["--domain", str(domain_id)]
        with subprocess.Popen(command, stdout=stream, stderr=subprocess.STDOUT) as launcher:
            watch(launcher)
    if launcher.returncode != 0:
        tail = " | ".join(log.read_text(encoding="utf-8", errors="replace").splitlines()[-LAST_LINES:])
        raise UavVslamError(f"the node graph failed (exit code {launcher.returncode}): {tail}")
    return estimates
