# SPDX-License-Identifier: Apache-2.0
"""What a vehicle's nodes cost: their processor time beside that of a bare node, in one run on the same readings.

All are processes of their own, on a ROS domain of their own. This process stands for the IMU and the camera's stamps,
and reads the odometry of `ins_propagator` and of the bare node. There are no images; `uav-vslam study live` has.
"""

import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
from nav_msgs.msg import Odometry
from sensor_msgs.msg import CameraInfo, Imu
from tf2_msgs.msg import TFMessage

from uav_vslam.datasets.messages import header_stamp_ns
from uav_vslam.errors import UavVslamError
from uav_vslam.geometry.pose import Pose
from uav_vslam.processes import processor_time_s
from uav_vslam.ros.convert import header, navigation_to_msg, transform_to_msg
from uav_vslam.ros.domain import claimed_domain
from uav_vslam.ros.qos import LATCHED, LATCHED_BY_MANY, SENSOR, STATE
from uav_vslam.ros.topic_tools import Observer, observer
from uav_vslam.types import NS_PER_S, NavEstimate, NavState
from uav_vslam_msgs.msg import NavigationState

IMU_RATES_HZ = (0, 200, 400)  # 0: at rest, before the first message
IMAGE_RATE_HZ = 50 / 7
GRAVITY = 9.81
WARM_UP_S = 3.0
START_S = 60.0  # limit for the nodes to come up
BARE = "bare_odometry"
ODOMETRY = {"ins_propagator": "/uav1/ins/odometry", BARE: "/uav1/bare/odometry"}
NODES = (*ODOMETRY, "stereo_frontend", "slam_backend", "fusion")


@dataclass(frozen=True, slots=True)
class NodeCost:
    """What one node took.

    Attributes:
        node: its name.
        imu_rate_hz: of the readings; 0 at rest.
        cores: processor time over wall time.
        ratio: of that to the bare node's; None at rest.
        rate_hz: of its odometry; None if nobody reads any.
        latency_ms: 50th and 99th percentile of the time from a reading's publication to its odometry's arrival [ms].
    """

    node: str
    imu_rate_hz: int
    cores: float
    ratio: float | None
    rate_hz: float | None = None
    latency_ms: tuple[float, float] | None = None


def node_costs(seconds: float) -> Iterator[NodeCost]:
    """Measure for so long at each rate, after a warm-up.

    Raises:
        UavVslamError: a node did not come up, or published nothing.
    """
    with claimed_domain() as domain_id, _started(domain_id) as processes, observer(domain_id, "sensors") as node:
        source = _Source(node)
        source.wait_for_nodes()
        for rate_hz in IMU_RATES_HZ:
            source.play(WARM_UP_S, rate_hz)
            before = {name: processor_time_s(process.pid) for name, process in processes.items()}
            begin_s = time.monotonic()
            source.latencies_s = {name: [] for name in ODOMETRY}
            source.play(seconds, rate_hz)
            elapsed_s = time.monotonic() - begin_s
            cores = {name: (processor_time_s(p.pid) - before[name]) / elapsed_s for name, p in processes.items()}
            for name in NODES:
                ratio = cores[name] / cores[BARE] if rate_hz else None
                latencies = source.latencies_s.get(name) if rate_hz else None
                yield NodeCost(name, rate_hz, cores[name], ratio, *_odometry_figures(name, latencies, elapsed_s))


def _odometry_figures(
    name: str, latencies_s: list[float] | None, elapsed_s: float
) -> tuple[float | None, tuple[float, float] | None]:
    """Return rate and latencies of a node's odometry; None where nobody reads any."""
    if latencies_s is None:
        return None, None
    if not latencies_s:
        raise UavVslamError(f"{name} published nothing")
    middle, late = (1000.0 * float(np.percentile(latencies_s, share)) for share in (50, 99))
    return len(latencies_s) / elapsed_s, (middle, late)


class _Source:
    """The sensors of a vehicle at rest, and the listener to both nodes."""

    def __init__(self, node: Observer) -> None:
        self._node = node
        self._sent_s: dict[int, float] = {}  # wall time of each reading, by its stamp
        self.latencies_s: dict[str, list[float]] = {name: [] for name in ODOMETRY}
        self._imu = node.create_publisher(Imu, "/uav1/imu/data_raw", SENSOR)
        self._info = node.create_publisher(CameraInfo, "/uav1/left/camera_info", STATE)
        self._latched: list[Any] = []
        for name, topic in ODOMETRY.items():
            node.create_subscription(
                Odometry, topic, lambda data, name=name: self._on_odometry(name, data), SENSOR, raw=True
            )
        self._stamp_ns = time.time_ns()
        self._image_ns = 0  # stamp of the newest image

    def _start(self) -> None:
        """Publish the frames and the start state of a vehicle at rest, once."""
        if self._latched:
            return
        state = NavState(self._stamp_ns, Pose.identity(), np.zeros(3), np.zeros(3), np.zeros(3))
        start = navigation_to_msg(
            NavEstimate(state, 1e-4 * np.eye(15)), frame_id="uav1/map", child_frame_id="uav1/base_link"
        )
        edge = transform_to_msg(Pose.identity(), stamp_ns=self._stamp_ns, parent="uav1/base_link", child="uav1/imu")
        states = self._node.create_publisher(NavigationState, "/uav1/initial_state", LATCHED)
        frames = self._node.create_publisher(TFMessage, "/tf_static", LATCHED_BY_MANY)
        states.publish(start)
        frames.publish(TFMessage(transforms=[edge]))
        self._latched += [states, frames]

    def wait_for_nodes(self) -> None:
        """Wait until all nodes are up and take what they need, and the odometry has been found."""
        if not self._node.spin_until(self._nodes_are_up, START_S):
            raise UavVslamError(f"the nodes {', '.join(NODES)} did not come up within {START_S:g} s")

    def _nodes_are_up(self) -> bool:
        node = self._node
        found = set(NODES) <= set(node.get_node_names()) and all(map(node.count_publishers, ODOMETRY.values()))
        return found and self._imu.get_subscription_count() >= len(ODOMETRY)

    def play(self, seconds: float, rate_hz: int) -> None:
        """Publish readings in real time; none at a rate of 0."""
        if rate_hz:
            self._start()
        begin_s = time.monotonic()
        for k in range(round(seconds * rate_hz)):
            self._spin_until(begin_s + k / rate_hz)
            self._stamp_ns += NS_PER_S // rate_hz
            self._publish()
        self._spin_until(begin_s + seconds)

    def _spin_until(self, due_s: float) -> None:
        self._node.spin_until(lambda: False, due_s - time.monotonic())

    def _publish(self) -> None:
        reading = Imu(header=header(self._stamp_ns, "uav1/imu"))
        reading.linear_acceleration.z = GRAVITY
        self._sent_s[self._stamp_ns] = time.monotonic()
        self._imu.publish(reading)
        if self._stamp_ns - self._image_ns >= NS_PER_S / IMAGE_RATE_HZ:
            self._image_ns = self._stamp_ns
            self._info.publish(CameraInfo(header=header(self._stamp_ns, "uav1/left")))

    def _on_odometry(self, name: str, data: bytes) -> None:
        sent_s = self._sent_s.get(header_stamp_ns(data))
        if sent_s is not None:
            self.latencies_s[name].append(time.monotonic() - sent_s)


@contextmanager
def _started(domain_id: int) -> Iterator[dict[str, subprocess.Popen[bytes]]]:
    environment = os.environ | {"ROS_DOMAIN_ID": str(domain_id)}
    arguments = ["--ros-args", "-r", "__ns:=/uav1", "--log-level", "error"]
    processes = {
        name: subprocess.Popen(
            [sys.executable, "-m", f"uav_vslam.ros.{name}_node", *arguments],
            env=environment,
        )
        for name in NODES
    }
    try:
        yield processes
    finally:
        for process in processes.values():
            process.terminate()
        for process in processes.values():
            process.wait()
