#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Flies two vehicles through the live node graph while one loses a node after the other, and reports what that costs.

    scripts/crash_flights.py --seeds 6            160 rendered frames each, at half the speed of the flight
    scripts/crash_flights.py --first-seed 11 --seeds 6 --rate 1

Front end, INS, back end and fusion of uav1 are killed in turn; the launcher starts them again. For each flight and
vehicle it prints the C-SLAM error at the end, the same of the flight without ROS and faults, their ratio, and mean and
largest position NEES per axis; at the end the root mean squares. Exit code 1 if a NEES exceeds 3, an error of uav1
doubles, or one of the peer grows by a twentieth, as root mean squares over the flights.
"""

import argparse
import os
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import rclpy
import yaml
from nav_msgs.msg import Odometry

from uav_vslam.cli.recordings import open_flights
from uav_vslam.config import load_fleet
from uav_vslam.datasets.messages import header_stamp_ns
from uav_vslam.datasets.outputs import RecordedOutputs, read_outputs
from uav_vslam.evaluation.consistency import nees
from uav_vslam.evaluation.trajectory import Trajectory
from uav_vslam.evaluation.trajectory_error import absolute_error
from uav_vslam.offline.flight import fly as fly_offline
from uav_vslam.ros.domain import claimed_domain
from uav_vslam.ros.qos import SENSOR
from uav_vslam.studies.live.compute import child_commands, node_name
from uav_vslam.types import PoseEstimate

ROOT = Path(__file__).parents[1]
COMMAND = [sys.executable, "-m", "uav_vslam.cli.main"]
NODES = ("stereo_frontend", "ins_propagator", "slam_backend", "fusion")  # in the order in which they are killed
FIRST, APART = 20, 30  # frame of the first kill, and frames between two
LAST = 10  # estimates that the error at the end is of
MOST = {"uav1": 2.0, "uav2": 1.05}  # of the error without faults
MOST_NEES = 3.0


def killed_in_turn(domain_id: int, launcher: subprocess.Popen[bytes], stamps_ns: list[int]) -> None:
    """Kill the nodes, each once uav1 has answered a frame, and wait for the end of the flight."""
    context = rclpy.Context()
    context.init(domain_id=domain_id)
    node = rclpy.create_node("crash_flights", context=context)
    executor = rclpy.executors.SingleThreadedExecutor(context=context)
    executor.add_node(node)
    answered = [0]
    node.create_subscription(
        Odometry, "/uav1/odometry", lambda data: answered.append(header_stamp_ns(data)), SENSOR, raw=True
    )
    waiting = list(NODES)
    while launcher.poll() is None:
        executor.spin_once(timeout_sec=0.05)
        if waiting and answered[-1] >= stamps_ns[FIRST + APART * (len(NODES) - len(waiting))]:
            os.kill(process_of(launcher.pid, f"uav1/{waiting.pop(0)}"), signal.SIGKILL)
    executor.shutdown()
    node.destroy_node()
    context.try_shutdown()
    if launcher.returncode or waiting:
        raise SystemExit(f"the launcher ended with {launcher.returncode}, not killed: {', '.join(waiting) or 'none'}")


def process_of(launcher: int, node: str) -> int:
    """Return the process of a node that a launcher has started."""
    return next(pid for pid, words in child_commands(launcher).items() if node_name(words) == node)


def end_error_m(poses: list[PoseEstimate], truth: Trajectory) -> float:
    """Return the root mean square position error at the end."""
    error = absolute_error(Trajectory.from_estimates(poses[-LAST:]), truth)
    if error is None:
        raise SystemExit("the truth does not cover the end of the flight")
    return error.ate_m


def launch(command: list[str], log: Path, stamps_ns: list[int]) -> None:
    """Fly through the live graph and kill the nodes of uav1 in turn."""
    with claimed_domain() as domain_id, log.open("wb") as printed:
        launcher = subprocess.Popen(
            [*COMMAND, "launch", *command, "--domain", str(domain_id)], stdout=printed, stderr=subprocess.STDOUT
        )
        try:
            killed_in_turn(domain_id, launcher, stamps_ns)
        finally:
            launcher.send_signal(signal.SIGINT)
            launcher.wait()


def score(flown: RecordedOutputs, undisturbed: list[PoseEstimate]) -> tuple[float, float, float]:
    """Return the errors at the end with and without faults [m], and the largest NEES per axis; print them."""
    truth = Trajectory.from_estimates(flown.truth)
    consistency = nees(Trajectory.from_estimates(flown.fused), truth)
    if consistency is None:
        raise SystemExit("fused/odometry has no covariance")
    faulty_m, undisturbed_m = end_error_m(flown.fused, truth), end_error_m(undisturbed, truth)
    mean, largest = float(consistency.position.mean()) / 3.0, float(consistency.position.max()) / 3.0
    print(f"{faulty_m:.3f}  {undisturbed_m:.3f}  {faulty_m / undisturbed_m:.2f}  {mean:.2f}  {largest:.2f}", flush=True)
    return faulty_m, undisturbed_m, largest


def fly(seed: int, rate: float, folder: Path) -> dict[str, tuple[float, float, float]]:
    """Fly one seed; return the scores of each vehicle."""
    bag, out, fleet = folder / f"flight_{seed}", folder / f"out_{seed}", folder / "fleet.yaml"
    simulate = [*COMMAND, "simulate", str(bag), "--seed", str(seed), "--scale", "0.5"]
    subprocess.run(simulate, check=True, stdout=subprocess.DEVNULL)
    vehicles = {name: {"config": str(ROOT / "config" / "kagaru.yaml")} for name in MOST}
    fleet.write_text(yaml.safe_dump({"vehicles": vehicles, "mode": "wideband"}), encoding="utf-8")
    configs = load_fleet(fleet).vehicles
    tracks, undisturbed = fly_offline(list(open_flights((bag,), configs).values()), configs, workers=2)
    stamps_ns = [output.report.pose.stamp_ns for output in tracks["uav1"].outputs]
    options = ["--bag", str(bag), "--rate", str(rate), "--record", str(out), "--on-failure", "restart"]
    launch([str(fleet), *options], folder / f"launch_{seed}.log", stamps_ns)
    scores = {}
    for name, flown in read_outputs([out, bag])[0].items():
        print(f"{seed:4d}  {name}  ", end="")
        scores[name] = score(flown, list(undisturbed[name].poses))
    return scores


def report(args: argparse.Namespace, folder: Path) -> int:
    """Fly all seeds; return the exit code."""
    print("seed  vehicle, error at the end with and without faults [m], ratio, NEES mean and largest")
    flights = [fly(args.first_seed + k, args.rate, folder) for k in range(args.seeds)]
    good = True
    for name, most in MOST.items():
        faulty_m, undisturbed_m, largest = np.array([flight[name] for flight in flights]).T
        ratio = float(np.sqrt(np.mean(faulty_m**2) / np.mean(undisturbed_m**2)))
        print(f"all   {name}  ratio {ratio:.3f} (at most {most:g}), NEES {largest.max():.2f} (at most {MOST_NEES:g})")
        good &= ratio <= most and largest.max() <= MOST_NEES
    print(f"recordings and logs: {folder}")
    return int(not good)


def main() -> int:
    """Entry point."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=6, help="number of flights (default 6)")
    parser.add_argument("--first-seed", type=int, default=1, help="of them (default 1)")
    parser.add_argument("--rate", type=float, default=0.5, help="of the replay over real time (default 0.5)")
    try:
        return report(parser.parse_args(), Path(tempfile.mkdtemp(prefix="uav_vslam_crash_")))
    except KeyboardInterrupt:
        return 130


if __name__ == "__main__":
    raise SystemExit(main())
