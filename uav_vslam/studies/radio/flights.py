# SPDX-License-Identifier: Apache-2.0
"""Flies the node graph in each packet mode and scores its recordings."""

import dataclasses
import tempfile
from collections.abc import Iterator
from pathlib import Path

from uav_vslam.config import find_config
from uav_vslam.datasets.cdr import decode
from uav_vslam.datasets.outputs import STATUS, read_outputs
from uav_vslam.datasets.recorded_result import flight_result
from uav_vslam.datasets.rosbag import iter_raw
from uav_vslam.errors import UavVslamError
from uav_vslam.evaluation.summary import build_summary
from uav_vslam.simulation.scenario import SCENARIOS
from uav_vslam.studies.engine.node_graph import fly_graph, record_fleet
from uav_vslam.studies.radio.compute import MODES, Run, packet_sizes


def fly_seed(seed: int, frames: int, scale: float) -> Iterator[tuple[str, list[Run] | UavVslamError]]:
    """Record a flight and yield each mode's runs, or why the graph failed. The recording is not kept."""
    scenario = dataclasses.replace(SCENARIOS["kagaru"], seed=seed, frames=frames, scale=scale)
    with tempfile.TemporaryDirectory(prefix="uav_vslam_radio_") as name:
        fleet = record_fleet(Path(name), scenario, find_config("kagaru"), coding="jpeg", rate=0.0)
        for mode in MODES:
            try:
                yield mode, read_runs(fly_graph(fleet, mode), fleet.parent / "flight", mode, seed)
            except UavVslamError as error:
                yield mode, error


def read_runs(estimates: Path, flight: Path, mode: str, seed: int) -> list[Run]:
    """Score a graph's recording of a flight.

    Raises:
        UavVslamError: the recording is damaged.
    """
    outputs, damage = read_outputs([estimates, flight])
    if damage is not None:
        raise damage
    sent: dict[str, list[tuple[int, int]]] = {name: [] for name in outputs}
    for raw in iter_raw([estimates], [f"/{name}/{STATUS}" for name in outputs]):
        status = decode(raw)
        sent[status.vehicle].append((int(status.packets_sent), int(status.bytes_sent)))
    vehicles = build_summary(flight_result(mode, outputs, config={}, wall_s=0.0), git=None)["vehicles"]
    return [Run(mode, seed, vehicles[name], packet_sizes(counters)) for name, counters in sent.items()]
