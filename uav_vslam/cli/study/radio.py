# SPDX-License-Identifier: Apache-2.0
"""`uav-vslam study radio`: what the packet modes cost and bring, measured on the whole node graph over DDS."""

from __future__ import annotations

import argparse
import dataclasses
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from uav_vslam.cli.arguments import results_folder
from uav_vslam.cli.progress import progress_bar
from uav_vslam.cli.study.common import add_seeds, publish, seeds_of

if TYPE_CHECKING:
    from uav_vslam.studies.radio.compute import Run

HELP = "rendered flights through the whole node graph, wideband and narrowband: error, payload, packets"
EXAMPLES = """examples:
  uav-vslam study radio                    5 flights of 160 frames, each in both modes; an hour
  uav-vslam study radio --seeds 1 --frames 30

One process a node, so nothing is run beside it; a flight's images take 170 MB while it lasts.
"""
CONFIG = "kagaru"
LAST_WORDS = 5  # lines of output that are told of a graph that failed


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the study's arguments."""
    add_seeds(parser, 5)
    parser.add_argument("--frames", type=int, default=160, help="frames of each vehicle (default 160)")
    parser.add_argument("--scale", type=float, default=1.0, help="image size over 1280 x 960 (default 1)")
    parser.add_argument("--results", type=results_folder, default="results", help="where results go (default results/)")


def run(args: argparse.Namespace) -> int:
    """Run the study; print its tables and write study.json."""
    from uav_vslam.studies.radio.compute import MODES, NOTES, radio_rows

    seeds, runs = seeds_of(args), []
    with progress_bar("study radio", len(seeds) * len(MODES)) as advance:
        for seed in seeds:
            for found in fly_seed(seed, args.frames, args.scale):
                runs += found
                advance()
    return publish("radio", radio_rows(runs, len(seeds)), seeds, args.results, notes=NOTES)


def fly_seed(seed: int, frames: int, scale: float) -> Iterator[list[Run]]:
    """Record a flight and yield its runs in each mode; none where the graph failed. The recording is not kept."""
    from uav_vslam.cli.simulate import record
    from uav_vslam.datasets.flight_writer import ImageCoding
    from uav_vslam.errors import UavVslamError
    from uav_vslam.simulation.scenario import SCENARIOS
    from uav_vslam.studies.radio.compute import MODES

    scenario = dataclasses.replace(SCENARIOS["kagaru"], seed=seed, frames=frames, scale=scale)
    with tempfile.TemporaryDirectory(prefix="uav_vslam_radio_") as name:
        folder = Path(name)
        record(scenario, folder / "flight", coding=ImageCoding("jpeg"))
        fleet = write_fleet(folder, [scenario.vehicle_name(k) for k in range(scenario.vehicles)])
        for mode in MODES:
            try:
                yield run_graph(fleet, mode, seed)
            except UavVslamError as error:
                print(f"uav-vslam: seed {seed}, {mode}: {error}", file=sys.stderr)
                yield []


def write_fleet(folder: Path, vehicles: list[str]) -> Path:
    """Write the file of a fleet that replays the folder's flight in lock-step."""
    import yaml

    from uav_vslam.config import find_config

    config = str(find_config(CONFIG).resolve())
    tree = {"vehicles": {name: {"config": config} for name in vehicles}, "replay": {"bags": ["flight"], "rate": 0.0}}
    path = folder / "fleet.yaml"
    path.write_text(yaml.safe_dump(tree), encoding="utf-8")
    return path


def run_graph(fleet: Path, mode: str, seed: int) -> list[Run]:
    """Run the node graph over the fleet's flight to its end and return what each vehicle made of it.

    Raises:
        UavVslamError: a process failed, or what was recorded is damaged.
    """
    from uav_vslam.errors import UavVslamError
    from uav_vslam.ros.domain import claimed_domain

    estimates = fleet.parent / mode
    launch = [sys.executable, "-m", "uav_vslam.cli.main", "launch", str(fleet), "--mode", mode]
    launch += ["--record", str(estimates)]
    with claimed_domain() as domain_id:
        launch += ["--domain", str(domain_id)]
        done = subprocess.run(launch, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False)
    if done.returncode != 0:
        said = " | ".join(done.stdout.splitlines()[-LAST_WORDS:])
        raise UavVslamError(f"the node graph failed (exit code {done.returncode}): {said}")
    return read_runs(estimates, fleet.parent / "flight", mode, seed)


def read_runs(estimates: Path, flight: Path, mode: str, seed: int) -> list[Run]:
    """Score what a graph recorded of a flight."""
    from uav_vslam.cli.evaluate import flight_result
    from uav_vslam.datasets.outputs import STATUS, read_outputs
    from uav_vslam.datasets.rosbag import decode, iter_raw
    from uav_vslam.evaluation.summary import build_summary
    from uav_vslam.studies.radio.compute import Run, packet_sizes

    outputs, damage = read_outputs([estimates, flight])
    if damage is not None:
        raise damage
    sent: dict[str, list[tuple[int, int]]] = {name: [] for name in outputs}
    for raw in iter_raw([estimates], [f"/{name}/{STATUS}" for name in outputs]):
        status = decode(raw)
        sent[status.vehicle].append((int(status.packets_sent), int(status.bytes_sent)))
    vehicles = build_summary(flight_result(mode, outputs, config={}, wall_s=0.0), git=None)["vehicles"]
    return [Run(mode, seed, vehicles[name], packet_sizes(counters)) for name, counters in sent.items()]
