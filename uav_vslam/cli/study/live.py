# SPDX-License-Identifier: Apache-2.0
"""`uav-vslam study live`: two vehicles' node graphs in real time on this machine."""

from __future__ import annotations

import argparse
import dataclasses
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING

from uav_vslam.cli.arguments import non_negative, results_folder
from uav_vslam.cli.study.common import publish

if TYPE_CHECKING:
    from uav_vslam.evaluation.study import Row
    from uav_vslam.studies.live.compute import Sample

HELP = "the whole node graph in real time on this machine: frames kept, and what each process needs of a core"
EXAMPLES = """examples:
  uav-vslam study live                                       two vehicles, 160 frames of 1280x960 at 7.14 Hz; a minute
  uav-vslam study live --rate 0.5                            half as fast
  uav-vslam study live --set frontend.method=sift            another front end

One flight; --seeds N is its seed. The recording takes 2.5 MB a frame and vehicle in the temporary folder.
"""
PERIOD_S = 0.5
LEADER = "replay"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the study's arguments."""
    parser.add_argument("--seeds", type=non_negative, default=1, metavar="N", help="seed of the flight (default 1)")
    parser.add_argument("--frames", type=int, default=160, help="frames of each vehicle (default 160)")
    parser.add_argument("--scale", type=float, default=1.0, help="image size over 1280 x 960 (default 1)")
    parser.add_argument("--rate", type=float, default=1.0, help="multiple of real time (default 1)")
    parser.add_argument("--mode", default="wideband", help="how the vehicles communicate (default wideband)")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="a setting of both vehicles")
    parser.add_argument("--results", type=results_folder, default="results", help="where results go (default results/)")


def run(args: argparse.Namespace) -> int:
    """Fly; print the tables and write study.json."""
    from uav_vslam.cli.simulate import record
    from uav_vslam.datasets.flight_writer import ImageCoding
    from uav_vslam.simulation.scenario import SCENARIOS
    from uav_vslam.studies.live.compute import NOTES

    scenario = dataclasses.replace(SCENARIOS["kagaru"], seed=args.seeds, frames=args.frames, scale=args.scale)
    with tempfile.TemporaryDirectory(prefix="uav_vslam_live_") as name:
        folder = Path(name)
        record(scenario, folder / "flight", coding=ImageCoding("raw"))
        vehicles = [scenario.vehicle_name(k) for k in range(scenario.vehicles)]
        fleet = write_fleet(folder, vehicles, args.set)
        rows = fly(fleet, args, frames=scenario.frames, duration_s=scenario.duration_s / args.rate)
    return publish("live", rows, [args.seeds], args.results, notes=NOTES)


def write_fleet(folder: Path, vehicles: list[str], settings: list[str]) -> Path:
    """Write the file of a fleet that replays the folder's flight."""
    import yaml

    from uav_vslam.cli.overrides import override
    from uav_vslam.config import find_config, load_vehicle, to_tree

    config = load_vehicle(find_config("kagaru"), overrides=dict(override(item) for item in settings))
    (folder / "vehicle.yaml").write_text(yaml.safe_dump(to_tree(config)), encoding="utf-8")
    tree = {"vehicles": {name: {"config": "vehicle.yaml"} for name in vehicles}, "replay": {"bags": ["flight"]}}
    path = folder / "fleet.yaml"
    path.write_text(yaml.safe_dump(tree), encoding="utf-8")
    return path


def fly(fleet: Path, args: argparse.Namespace, *, frames: int, duration_s: float) -> list[Row]:
    """Run the graph to the end of the flight and return what it kept up with and what that took.

    Raises:
        UavVslamError: a process failed.
    """
    from uav_vslam.datasets.outputs import read_outputs
    from uav_vslam.errors import UavVslamError
    from uav_vslam.ros.domain import claimed_domain
    from uav_vslam.studies.live.compute import frame_rows, processor_rows

    estimates, log = fleet.parent / "estimates", fleet.parent / "launch.txt"
    command = [sys.executable, "-m", "uav_vslam.cli.main", "launch", str(fleet), "--rate", str(args.rate)]
    command += ["--mode", args.mode, "--record", str(estimates)]
    with claimed_domain() as domain_id, log.open("wb") as stream:
        command += ["--domain", str(domain_id)]
        with subprocess.Popen(command, stdout=stream, stderr=subprocess.STDOUT) as launcher:
            samples = watch(launcher)
    if launcher.returncode != 0:
        said = " | ".join(log.read_text(encoding="utf-8", errors="replace").splitlines()[-3:])
        raise UavVslamError(f"the node graph failed (exit code {launcher.returncode}): {said}")
    outputs, _ = read_outputs([estimates])
    processed = {name: len(output.own_only) for name, output in outputs.items()}
    return [*frame_rows(processed, frames, args.rate), *processor_rows(samples, LEADER, duration_s)]


def watch(launcher: subprocess.Popen[bytes]) -> list[Sample]:
    """Look at the launcher's processes until it ends."""
    from uav_vslam.studies.live.compute import sample_children

    samples: list[Sample] = []
    while launcher.poll() is None:
        try:
            samples.append(sample_children(launcher.pid, time.monotonic()))
        except OSError:
            break  # it has just ended
        time.sleep(PERIOD_S)
    return samples
