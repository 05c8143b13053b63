# SPDX-License-Identifier: Apache-2.0
"""Flies the node graph in real time and samples the processor time of its processes."""

import dataclasses
import tempfile
import time
from pathlib import Path

import yaml

from uav_vslam.config import VehicleConfig, parameter_file
from uav_vslam.datasets.outputs import read_outputs
from uav_vslam.evaluation.study import Row
from uav_vslam.simulation.scenario import SCENARIOS
from uav_vslam.studies.engine.node_graph import Launcher, fly_graph, record_fleet
from uav_vslam.studies.live.compute import Sample, frame_rows, processor_rows, sample_children

PERIOD_S = 0.5
LEADER = "replay"


def fly(seed: int, config: VehicleConfig, *, frames: int, scale: float, rate: float, mode: str) -> list[Row]:
    """Record a flight, replay it through the graph, and return the frames processed and the processor time.

    Raises:
        UavVslamError: a process failed.
    """
    scenario = dataclasses.replace(SCENARIOS["kagaru"], seed=seed, frames=frames, scale=scale)
    samples: list[Sample] = []
    with tempfile.TemporaryDirectory(prefix="uav_vslam_live_") as name:
        file = Path(name) / "vehicle.yaml"
        file.write_text(yaml.safe_dump(parameter_file({"/**": config})), encoding="utf-8")
        fleet = record_fleet(Path(name), scenario, file, coding="raw", rate=rate)
        outputs, _ = read_outputs([fly_graph(fleet, mode, watch=lambda launcher: _sample(launcher, samples))])
    processed = {vehicle: len(output.own_only) for vehicle, output in outputs.items()}
    duration_s = scenario.duration_s / rate
    condition = f"seed {seed}, {rate:g} x real time"
    return [*frame_rows(processed, frames, condition), *processor_rows(samples, LEADER, duration_s, condition)]


def _sample(launcher: Launcher, samples: list[Sample]) -> None:
    """Sample the launcher's processes until it ends."""
    while launcher.poll() is None:
        try:
            samples.append(sample_children(launcher.pid, time.monotonic()))
        except OSError:
            break  # it has just ended
        time.sleep(PERIOD_S)
