# SPDX-License-Identifier: Apache-2.0
"""A node that is killed in flight comes back under the launcher, and the flight ends as well as without."""

import contextlib
import os
import signal
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

rclpy = pytest.importorskip("rclpy", reason="needs ROS")
from nav_msgs.msg import Odometry  # noqa: E402
from node_processes import Witness  # noqa: E402
from short_bag import before  # noqa: E402

from uav_vslam.cli.recordings import open_flights  # noqa: E402
from uav_vslam.config import load_fleet  # noqa: E402
from uav_vslam.datasets.messages import stamp_ns_of  # noqa: E402
from uav_vslam.datasets.outputs import RecordedOutputs, read_outputs  # noqa: E402
from uav_vslam.evaluation.consistency import nees  # noqa: E402
from uav_vslam.evaluation.trajectory import Trajectory  # noqa: E402
from uav_vslam.evaluation.trajectory_error import absolute_error  # noqa: E402
from uav_vslam.fleet import CooperativeTrack  # noqa: E402
from uav_vslam.offline.flight import fly as fly_offline  # noqa: E402
from uav_vslam.pipeline import VehicleTrack  # noqa: E402
from uav_vslam.simulation.scenario import START_NS  # noqa: E402
from uav_vslam.types import NS_PER_S, PoseEstimate  # noqa: E402
from waiting import wait_for  # noqa: E402

pytestmark = [pytest.mark.ros, pytest.mark.slow]

ROOT = Path(__file__).parents[2]
SAMPLE = ROOT / "bags" / "sample"
LONGEST_GAP_S = 0.6  # between two poses, where a node is back as soon as on an idle machine
BEGIN_S = 5.0  # of the sample that is flown, five epochs: what follows would show nothing else
FRAMES = 20  # of the lock-step flight: two epochs
Launched = Callable[..., AbstractContextManager[Any]]
Tracks = dict[str, tuple[VehicleTrack, CooperativeTrack]]


def fly(
    launched: Launched, folder: Path, bag: Path, kills: dict[int, str], *, rate: float
) -> dict[str, RecordedOutputs]:
    """Fly a recording, kill nodes, each when uav1 has answered a frame of that stamp, and return the estimates."""
    arguments = ["--bag", str(bag), "--on-failure", "restart", "--record", str(folder / "out"), "--rate", str(rate)]
    printed: list[str] = []
    answered_ns = [0]
    fleet = str(ROOT / "config" / "fleet_demo.yaml")
    with launched(fleet, *arguments, "--log-dir", str(folder / "log")) as graph, Witness(graph.domain_id) as witness:
        witness.node.create_subscription(
            Odometry, "/uav1/odometry", lambda message: answered_ns.append(stamp_ns_of(message)), 10
        )
        pipe = graph.process.stdout.fileno()
        os.set_blocking(pipe, False)

        def listen() -> None:
            witness.turn()
            with contextlib.suppress(BlockingIOError):
                printed.append(os.read(pipe, 1 << 16).decode())

        for stamp_ns, node in kills.items():
            assert wait_for(lambda stamp_ns=stamp_ns: answered_ns[-1] >= stamp_ns, listen, alive=graph.alive)
            os.kill(graph.pid_of(node), signal.SIGKILL)
        assert wait_for(lambda: not graph.alive(), listen)
        listen()
        assert graph.process.returncode == 0, "".join(printed)
    for node in kills.values():
        assert f"{node} was killed by SIGKILL; it is restarted" in "".join(printed)
    assert "".join(printed).count("the vehicles have no key") == 1
    outputs, damage = read_outputs([folder / "out", bag])
    assert not damage
    return outputs


@pytest.fixture(scope="module")
def begin(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The recording that is flown."""
    return before(START_NS + round(BEGIN_S * NS_PER_S), SAMPLE, tmp_path_factory.mktemp("sample") / "begin")


@pytest.fixture(scope="module")
def undisturbed(begin: Path) -> Tracks:
    """The same flight without ROS, which the graph equals (test_parity)."""
    configs = load_fleet(ROOT / "config" / "fleet_demo.yaml").vehicles
    flights = open_flights((begin,), configs)
    tracks, fleet = fly_offline(list(flights.values()), configs)
    return {name: (tracks[name], fleet[name]) for name in fleet}


def stamps_ns(undisturbed: Tracks) -> list[int]:
    """Return the stamps of uav1's frames."""
    return [output.report.pose.stamp_ns for output in undisturbed["uav1"][0].outputs]


def test_a_back_end_killed_in_lock_step_catches_up_to_the_same_estimates(
    launched: Launched, tmp_path: Path, begin: Path, undisturbed: Tracks
) -> None:
    """The own ones to the digit; landmarks since the checkpoint have new identifiers, so fusion may differ a little."""
    frames_ns = stamps_ns(undisturbed)
    end_ns = frames_ns[FRAMES]
    bag = before(end_ns, begin, tmp_path / "two_epochs")
    outputs = fly(launched, tmp_path, bag, {frames_ns[12]: "uav1/slam_backend"}, rate=0.0)
    for name, (own, fused) in undisturbed.items():
        expected = {pose.stamp_ns: pose.T_map_body.t for pose in fused.poses if pose.stamp_ns < end_ns}
        assert {pose.stamp_ns for pose in outputs[name].fused} == set(expected)
        last = outputs[name].fused[-1]
        np.testing.assert_allclose(last.T_map_body.t, expected[last.stamp_ns], rtol=0, atol=0.01)
        pose = [output.report.pose for output in own.outputs if output.report.pose.stamp_ns < end_ns][-1]
        assert outputs[name].own_only[-1].stamp_ns == pose.stamp_ns
        np.testing.assert_allclose(outputs[name].own_only[-1].T_map_body.t, pose.T_map_body.t, rtol=0, atol=1e-6)


def end_error_m(estimates: list[PoseEstimate], truth: Trajectory) -> float:
    """Return the root mean square position error of the last ten estimates [m]."""
    error = absolute_error(Trajectory.from_estimates(estimates[-10:]), truth)
    assert error is not None
    return error.ate_m


def longest_gap_s(estimates: list[PoseEstimate]) -> float:
    """Return the longest time between two estimates [s]."""
    return float(np.diff([pose.stamp_ns for pose in estimates]).max()) / NS_PER_S


def test_each_node_of_a_vehicle_killed_in_turn_leaves_it_consistent(
    launched: Launched, tmp_path: Path, begin: Path, undisturbed: Tracks
) -> None:
    """In real time, slowly enough that a busy machine has the last node back before the flight ends."""
    nodes = ("stereo_frontend", "ins_propagator", "slam_backend", "fusion")
    frames_ns = stamps_ns(undisturbed)
    kills = {frames_ns[5 + 6 * k]: f"uav1/{node}" for k, node in enumerate(nodes)}
    outputs = fly(launched, tmp_path, begin, kills, rate=0.1)
    for name, flown in outputs.items():
        truth, calm = Trajectory.from_estimates(flown.truth), list(undisturbed[name][1].poses)
        assert flown.fused[-1].stamp_ns == calm[-1].stamp_ns
        consistency = nees(Trajectory.from_estimates(flown.fused), truth)
        assert consistency is not None
        assert consistency.position.max() / 3 <= 3.0
        error_m, calm_m = end_error_m(flown.fused, truth), end_error_m(calm, truth)
        # 1.1 to 1.8 times as large here. The peer loses what it would have gained, and, as what is fused has errors of
        # its own, in a single flight a little of what it claims.
        claimed_m = float(np.sqrt(np.trace(flown.fused[-1].covariance[:3, :3])))
        alone_m = max(calm_m, end_error_m(flown.own_only, truth))
        limit_m = 3.0 * calm_m if name == "uav1" else alone_m + 0.1 * claimed_m
        if longest_gap_s(flown.own_only) > LONGEST_GAP_S:  # a busy machine had a node back late: more was lost
            ins = [output.dead_reckoning.pose for output in undisturbed[name][0].outputs]
            limit_m = 0.25 * end_error_m(ins, truth)
        assert error_m <= limit_m
