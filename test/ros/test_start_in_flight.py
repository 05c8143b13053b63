# SPDX-License-Identifier: Apache-2.0
"""The back end estimates and publishes the start; the INS preintegrates before, and dead-reckons from it afterwards."""

import dataclasses
from collections.abc import Iterator

import numpy as np
import pytest

rclpy = pytest.importorskip("rclpy", reason="needs ROS")
from nav_msgs.msg import Odometry  # noqa: E402
from rclpy.executors import SingleThreadedExecutor  # noqa: E402
from sensor_msgs.msg import CameraInfo, Imu  # noqa: E402

from uav_vslam.ros.convert import features_to_msg, header, navigation_from_msg, stamp_from_ns  # noqa: E402
from uav_vslam.ros.ins_propagator_node import InsPropagatorNode  # noqa: E402
from uav_vslam.ros.qos import LATCHED, RESUMABLE, SENSOR, STATE  # noqa: E402
from uav_vslam.ros.slam_backend_node import SlamBackendNode  # noqa: E402
from uav_vslam.simulation.landmarks import observe, scatter_landmarks  # noqa: E402
from uav_vslam.simulation.scenario import SCENARIOS, SimulatedVehicle, simulate_vehicle  # noqa: E402
from uav_vslam.types import ImuSample, StereoFeatures  # noqa: E402
from uav_vslam_msgs.msg import NavigationState  # noqa: E402
from uav_vslam_msgs.msg import StereoFeatures as StereoFeaturesMsg  # noqa: E402
from waiting import wait_for  # noqa: E402

pytestmark = pytest.mark.ros
FRAMES = 12


class Graph:
    """Both nodes and a listener in one executor; the rig is set directly instead of by topics."""

    def __init__(self, vehicle: SimulatedVehicle) -> None:
        self.backend, self.ins = SlamBackendNode(), InsPropagatorNode()
        self.other = rclpy.create_node("tester")
        self.backend._rig.rig = vehicle.rig
        self.size = vehicle.rig.left.width, vehicle.rig.left.height
        self.starts: list[NavigationState] = []
        self.odometry: list[Odometry] = []
        self.dead_reckoned: list[Odometry] = []
        self.live: list[Odometry] = []
        for kind, topic, heard, qos in (
            (NavigationState, "initial_state", self.starts, LATCHED),
            (Odometry, "odometry", self.odometry, STATE),
            (Odometry, "ins/dead_reckoning", self.dead_reckoned, STATE),
            (Odometry, "ins/odometry", self.live, STATE),
        ):
            self.other.create_subscription(kind, topic, heard.append, qos)
        self._imu = self.other.create_publisher(Imu, "imu/data_raw", SENSOR)
        self._info = self.other.create_publisher(CameraInfo, "left/camera_info", STATE)
        self._features = self.other.create_publisher(StereoFeaturesMsg, "stereo_features", RESUMABLE)
        self._executor = SingleThreadedExecutor()
        for node in (self.backend, self.ins, self.other):
            self._executor.add_node(node)

    def spin_until(self, condition) -> bool:
        return wait_for(condition, lambda: self._executor.spin_once(timeout_sec=0.02))

    def connected(self) -> bool:
        publishers = (self._imu, self._info, self._features)
        found = all(publisher.get_subscription_count() for publisher in publishers)
        return found and all(self.other.count_publishers(topic) for topic in ("initial_state", "odometry"))

    def feed(self, sample: ImuSample) -> None:
        message = Imu(header=header(sample.stamp_ns, self.ins.base_frame))
        message.angular_velocity.x, message.angular_velocity.y, message.angular_velocity.z = sample.gyro
        message.linear_acceleration.x, message.linear_acceleration.y, message.linear_acceleration.z = sample.accel
        self._imu.publish(message)

    def show(self, features: StereoFeatures) -> None:
        self._info.publish(CameraInfo(header=header(features.stamp_ns, "left_optical")))
        self._features.publish(features_to_msg(features, frame_id="left_optical", size=self.size))

    def close(self) -> None:
        for node in (self.backend, self.ins, self.other):
            node.destroy_node()


@pytest.fixture(scope="module")
def vehicle() -> SimulatedVehicle:
    return simulate_vehicle(dataclasses.replace(SCENARIOS["kagaru"], frames=FRAMES, vehicles=1), 0)


@pytest.fixture
def graph(vehicle: SimulatedVehicle, domain_id: int) -> Iterator[Graph]:
    arguments = ["--ros-args", "-r", "__ns:=/uav1", "-p", "start.method:=in_flight"]
    rclpy.init(args=arguments, domain_id=domain_id)
    graph = Graph(vehicle)
    yield graph
    graph.close()
    rclpy.shutdown()


def stamps(messages: list) -> list[tuple[int, int]]:
    return [(message.header.stamp.sec, message.header.stamp.nanosec) for message in messages]


def test_the_start_that_the_back_end_finds_starts_the_ins(graph: Graph, vehicle: SimulatedVehicle) -> None:
    assert graph.spin_until(graph.connected)
    frames = {f.stamp_ns: f for f, _ in observe(vehicle, scatter_landmarks([vehicle]))}
    waiting = dict(frames)
    for sample in vehicle.imu.samples():
        for stamp_ns in [s for s in waiting if s <= sample.stamp_ns]:
            graph.show(waiting.pop(stamp_ns))
        graph.feed(sample)
        graph.spin_until(lambda newest=sample.stamp_ns: newest_of(graph.ins) >= newest)
    expected = [(stamp.sec, stamp.nanosec) for stamp in map(stamp_from_ns, frames)]
    assert graph.spin_until(lambda: len(graph.odometry) == FRAMES and len(graph.dead_reckoned) == FRAMES)
    assert stamps(graph.odometry) == expected
    assert stamps(graph.dead_reckoned) == expected
    (start,) = graph.starts
    found = navigation_from_msg(start)
    assert found.state.stamp_ns == min(frames)
    np.testing.assert_array_equal(found.state.T_map_body.t, np.zeros(3))
    # propagation starts at the start; buffered samples come in a burst, of which a slow subscriber keeps the last
    newest = stamp_from_ns(vehicle.imu.samples()[-1].stamp_ns)
    assert graph.spin_until(lambda: stamps(graph.live)[-1:] == [(newest.sec, newest.nanosec)])
    assert min(stamps(graph.live)) > expected[0]
    assert graph.backend.notes["start"] == "found in flight"
    assert graph.backend.counts["dropped/before_start"] == 0


def newest_of(ins: InsPropagatorNode) -> int:
    """Return the stamp of the newest IMU sample that the node has processed."""
    samples = ins._preintegrator._buffer._samples
    return samples[-1].stamp_ns if samples else -1


def test_diagnostics_report_why_there_is_no_start_yet(graph: Graph, vehicle: SimulatedVehicle) -> None:
    assert graph.spin_until(graph.connected)
    blind = [StereoFeatures.empty(int(stamp_ns)) for stamp_ns in vehicle.frame_stamps_ns]
    for sample in vehicle.imu.samples():
        while blind and blind[0].stamp_ns <= sample.stamp_ns:
            graph.show(blind.pop(0))
        graph.feed(sample)
        graph.spin_until(lambda newest=sample.stamp_ns: newest_of(graph.ins) >= newest)
    assert graph.spin_until(lambda: graph.backend.counts["dropped/before_start"] == FRAMES)
    assert graph.backend.notes["start"].startswith("searching: of 0 points only")
    assert graph.starts == []
    assert graph.live == []


def test_increments_queue_as_deep_as_readings(graph: Graph) -> None:
    """A back end that is busy with one frame for a second must receive the increments of all others."""
    ends = [*graph.ins.publishers, *graph.backend.subscriptions]
    depths = [end.qos_profile.depth for end in ends if end.topic_name == "/uav1/ins/increment"]
    assert depths == [SENSOR.depth] * 2
