#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Flies a fleet's recordings again and again through the live node graph, in real time, and reports what grows.

    scripts/long_flight.py --minutes 30                        the sample recordings, two vehicles
    scripts/long_flight.py --minutes 5 --switch uav2 narrowband    the same, one vehicle in another mode half-way

Between passes the clock of the sensors jumps back, so the vehicles start again in a new session each time. It prints a
row a minute: resident memory of each node, the delay of odometry and of fused odometry after their images and of
inertial odometry after its reading, and the load; at the end the packets sent, received, used and dropped, and the
shared memory of Fast DDS. Exit code 1 if a node's memory after warm-up (a quarter of the time) grew by more than a
tenth, a packet is unaccounted for, or shared memory is left.
"""

import argparse
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
import yaml
from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import Odometry

from uav_vslam.cli.progress import progress_bar
from uav_vslam.config import load_fleet
from uav_vslam.datasets.messages import header_stamp_ns
from uav_vslam.ros.answers import Answers
from uav_vslam.ros.domain import claimed_domain
from uav_vslam.ros.pacing import RealTime
from uav_vslam.ros.qos import IMAGE, LATCHED, SENSOR, STATE
from uav_vslam.ros.recorded import Kind, Recorded
from uav_vslam.ros.recording import Recording
from uav_vslam.ros.shared_memory import FOLDER
from uav_vslam.studies.live.compute import PROC, child_commands, node_name
from uav_vslam_msgs.msg import FusionStatus

ROOT = Path(__file__).parents[1]
QOS = {Kind.LEFT: IMAGE, Kind.RIGHT: IMAGE, Kind.IMU: SENSOR}
ANSWERS = {"odometry": Kind.RIGHT, "fused/odometry": Kind.RIGHT, "ins/odometry": Kind.IMU}  # and what they answer
PAUSE_S = 2.0  # between passes
MOST_GROWTH = 0.10
IN_FLIGHT = 2  # packets that may be on their way at the end


class LongFlight:
    """The player, and what it receives from the graph."""

    def __init__(self, fleet: Path, domain_id: int) -> None:
        config = load_fleet(fleet)
        self.recording = Recording(config.replay.bags, tuple(config.vehicles))
        self.domain_id = domain_id
        self._context = rclpy.Context()
        self._context.init(domain_id=domain_id)
        self.node = rclpy.create_node("long_flight", context=self._context)
        self._executor = rclpy.executors.SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)
        self._latched = {raw.topic for raw in self.recording.latched}
        self._publishers = {topic: self._advertise(topic) for topic in self.recording.topics}
        self._sent_s: dict[tuple[str, Kind], dict[int, float]] = defaultdict(dict)
        self.delays_ms: dict[str, list[float]] = defaultdict(list)
        self.statuses: dict[str, FusionStatus] = {}
        self.diagnostics: dict[str, Any] = {}
        self.frames = 0
        for vehicle in self.recording.vehicles:
            for topic, kind in ANSWERS.items():
                on_answer = partial(self._on_answer, vehicle, topic, kind)
                self.node.create_subscription(Odometry, f"/{vehicle}/{topic}", on_answer, SENSOR, raw=True)
            keep = partial(self.statuses.__setitem__, vehicle)
            self.node.create_subscription(FusionStatus, f"/{vehicle}/fusion/status", keep, STATE)
        self.node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 100)

    def fly(self, until_s: float, each: Callable[[], None]) -> None:
        """Play passes until the time is over."""
        while time.monotonic() < until_s:
            for raw in self.recording.latched:
                self._publishers[raw.topic].publish(raw.data)
            self._spin(PAUSE_S)
            pacer = RealTime(Answers(self.recording.vehicles, {}, ()), 1.0)
            for message in pacer.order(self.recording.messages()):
                if message is None:
                    self._executor.spin_once(timeout_sec=0.001)
                else:
                    self._publish(message)
            self._spin(PAUSE_S)
            each()

    def wait_for_nodes(self) -> None:
        """Wait until all nodes listen."""
        consumed = [topic for name in self.recording.vehicles for topic in self.recording.consumed(name)]
        while any(self._publishers[topic].get_subscription_count() == 0 for topic in consumed):
            self._spin(0.5)
        self._spin(5.0)  # they discover each other meanwhile

    def close(self) -> None:
        """Leave the graph."""
        self._executor.shutdown()
        self.node.destroy_node()
        self._context.try_shutdown()

    def _spin(self, for_s: float) -> None:
        end_s = time.monotonic() + for_s
        while time.monotonic() < end_s:
            self._executor.spin_once(timeout_sec=0.01)

    def _advertise(self, topic: str) -> Any:
        package, _, name = self.recording.topics[topic].msgtype.split("/")
        _, kind = self.recording.classify(topic)
        qos = LATCHED if topic in self._latched else QOS.get(kind, STATE)
        return self.node.create_publisher(getattr(import_module(f"{package}.msg"), name), topic, qos)

    def _publish(self, message: Recorded) -> None:
        self._publishers[message.topic].publish(message.payload)
        self._sent_s[message.vehicle, message.kind][message.stamp_ns] = time.monotonic()
        self.frames += message.kind is Kind.RIGHT

    def _on_answer(self, vehicle: str, topic: str, kind: Kind, data: bytes) -> None:
        sent_s = self._sent_s[vehicle, kind].get(header_stamp_ns(data))
        if sent_s is not None:
            self.delays_ms[topic].append(1e3 * (time.monotonic() - sent_s))

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        self.diagnostics |= {status.name: status for status in message.status}


def memory_mb(launcher: int) -> dict[str, float]:
    """Return the resident memory of each node that a launcher has started [MB]."""
    found = {}
    for pid, words in child_commands(launcher).items():
        pages = int((PROC / str(pid) / "statm").read_text().split()[1])
        found[node_name(words) or words[-1]] = pages * os.sysconf("SC_PAGE_SIZE") / 1e6
    return found


def shared_files() -> set[str]:
    """Return the files of Fast DDS in shared memory."""
    return {path.name for path in FOLDER.glob("*fastrtps_*")}


def counts_lines(flight: LongFlight) -> tuple[list[str], int]:
    """Return a line for each direction of the radio, and how many packets are unaccounted for."""
    lines, missing = [], 0
    for receiver, status in sorted(flight.statuses.items()):
        for link in status.peers:
            sent = flight.statuses[link.peer].packets_sent
            drops = ", ".join(f"{r} {n}" for r, n in zip(link.drop_reasons, link.drop_counts, strict=True)) or "none"
            lines.append(
                f"{link.peer} to {receiver}: sent {sent}, received {link.packets_received}, used {link.packets_used}, "
                f"waiting {link.packets_waiting}; dropped: {drops}"
            )
            missing += max(sent - link.packets_received - IN_FLIGHT, 0)
            missing += abs(link.packets_received - link.packets_used - link.packets_waiting - sum(link.drop_counts))
    return lines, missing


def fly(args: argparse.Namespace, folder: Path) -> int:
    """Start the nodes, play, and report; return the exit code."""
    fleet, tree = args.fleet.resolve(), yaml.safe_load(args.fleet.read_text(encoding="utf-8"))
    for vehicle in tree["vehicles"].values():
        vehicle["config"] = str((fleet.parent / vehicle["config"]).resolve())
    del tree["replay"]  # the nodes alone
    (folder / "fleet.yaml").write_text(yaml.safe_dump(tree), encoding="utf-8")
    before = shared_files()
    with claimed_domain() as domain_id, (folder / "launch.log").open("wb") as log:
        command = [sys.executable, "-m", "uav_vslam.cli.main", "launch", str(folder / "fleet.yaml")]
        launcher = subprocess.Popen([*command, "--domain", str(domain_id)], stdout=log, stderr=subprocess.STDOUT)
        flight = LongFlight(fleet, domain_id)
        try:
            growth, missing = report(flight, launcher.pid, args)
        finally:
            launcher.send_signal(signal.SIGINT)
            launcher.wait()
            flight.close()
    left = shared_files() - before
    print(f"shared memory of Fast DDS left: {', '.join(sorted(left)) or 'none'}; log: {folder / 'launch.log'}")
    return int(growth > MOST_GROWTH or missing > 0 or bool(left))


def report(flight: LongFlight, launcher: int, args: argparse.Namespace) -> tuple[float, int]:
    """Play until the time is over and print the rows; return the largest growth of memory, and packets missing."""
    flight.wait_for_nodes()
    begin_s, rows = time.monotonic(), []
    print(f"minutes  load  {'  '.join(f'{topic} p50/p99 [ms]' for topic in ANSWERS)}  memory [MB]")
    with progress_bar("flying", round(60 * args.minutes)) as advance:

        def each() -> None:
            at_s = time.monotonic() - begin_s
            if args.switch and at_s >= 30 * args.minutes:
                command = [sys.executable, "-m", "uav_vslam.cli.main", "mode", *args.switch]
                subprocess.run(command, check=False, env=os.environ | {"ROS_DOMAIN_ID": str(flight.domain_id)})
                args.switch = None  # once
            advance(round(at_s - (rows[-1][0] if rows else 0.0)))
            rows.append((at_s, memory_mb(launcher)))
            if not rows[1:] or at_s // 60 > rows[-2][0] // 60:
                print_row(flight, rows[-1])

        flight.fly(begin_s + 60 * args.minutes, each)
    lines, missing = counts_lines(flight)
    frames = sum(
        int(value.value)
        for status in flight.diagnostics.values()
        for value in status.values
        if status.name.endswith("slam_backend") and value.key == "frames"
    )
    print("\n".join([*lines, f"frames: {frames} of {flight.frames} processed"]))
    warm = [memory for at_s, memory in rows if at_s >= 15 * args.minutes]
    quarter = max(len(warm) // 4, 1)
    growth = {
        name: np.median([m[name] for m in warm[-quarter:]]) / np.median([m[name] for m in warm[:quarter]]) - 1.0
        for name in warm[-1]
    }
    print("growth after warm-up: " + ", ".join(f"{name} {100 * share:+.1f} %" for name, share in growth.items()))
    return max(growth.values()), missing


def print_row(flight: LongFlight, row: tuple[float, dict[str, float]]) -> None:
    """Print what was measured since the last row."""
    delays = []
    for topic in ANSWERS:
        delays_ms = flight.delays_ms.pop(topic, [np.nan])
        delays.append(f"{np.median(delays_ms):.0f}/{np.percentile(delays_ms, 99):.0f} ({len(delays_ms)})")
    memory = ", ".join(f"{name} {mb:.0f}" for name, mb in sorted(row[1].items()))
    print(f"{row[0] / 60:7.1f}  {os.getloadavg()[0]:4.1f}  {'  '.join(delays)}  {memory}", flush=True)


def main() -> int:
    """Entry point."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("fleet", nargs="?", type=Path, default=ROOT / "config" / "fleet_demo.yaml", help="fleet file")
    parser.add_argument("--minutes", type=float, default=30.0, help="of flight (default 30)")
    parser.add_argument("--switch", nargs=2, metavar=("NAME", "MODE"), help="communication mode of a vehicle, half-way")
    args = parser.parse_args()
    try:
        return fly(args, Path(tempfile.mkdtemp(prefix="uav_vslam_long_")))
    except KeyboardInterrupt:
        return 130


if __name__ == "__main__":
    raise SystemExit(main())
