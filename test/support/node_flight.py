# SPDX-License-Identifier: Apache-2.0
"""A vehicle's INS, back end and fusion in one executor, and a player that feeds them a simulated flight."""

import copy
import dataclasses
from collections.abc import Callable
from functools import partial
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from nav_msgs.msg import Odometry
from rclpy.executors import SingleThreadedExecutor
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import CameraInfo, Imu

from uav_vslam.ros.convert import features_to_msg, header, navigation_to_msg, stamp_from_ns
from uav_vslam.ros.fusion_node import FusionNode
from uav_vslam.ros.ins_propagator_node import InsPropagatorNode
from uav_vslam.ros.qos import LATCHED, RESUMABLE, SENSOR, STATE
from uav_vslam.ros.slam_backend_node import SlamBackendNode
from uav_vslam.ros.vehicle_node import VehicleNode
from uav_vslam.simulation.landmarks import observe, scatter_landmarks
from uav_vslam.simulation.scenario import SimulatedVehicle
from uav_vslam.types import NS_PER_S, ImuSample, NavEstimate, StereoFeatures
from uav_vslam_msgs.msg import InsIncrement, JointInformation, NavigationState
from uav_vslam_msgs.msg import StereoFeatures as StereoFeaturesMsg
from waiting import wait_for

INNER: dict[str, Any] = {  # messages between the nodes
    "ins/increment": InsIncrement,
    "stereo_features": StereoFeaturesMsg,
    "odometry": Odometry,
    "joint_information": JointInformation,
    "slam/correction": NavigationState,
}


class NodeFlight:
    """The nodes; rclpy is initialised by the caller, in the vehicle's namespace. The rig is set, not sent.

    Attributes:
        ins, backend, fusion: the nodes.
        odometry, fused: what was received of both estimates.
        statuses: of each node the last diagnostics.
        newest: of each message between nodes.
    """

    def __init__(self, vehicle: SimulatedVehicle) -> None:
        self.ins, self.backend, self.fusion = InsPropagatorNode(), SlamBackendNode(), FusionNode()
        self.player = rclpy.create_node("player")
        self.odometry: list[Odometry] = []
        self.fused: list[Odometry] = []
        self.statuses: dict[str, DiagnosticStatus] = {}
        self.newest: dict[str, Any] = {}
        self._vehicle = vehicle
        self._size = vehicle.rig.left.width, vehicle.rig.left.height
        self.backend._rig.rig = vehicle.rig
        self.features = [seen for seen, _ in observe(vehicle, scatter_landmarks([vehicle]))]
        self.player.create_subscription(Odometry, "odometry", self.odometry.append, RESUMABLE)
        self.player.create_subscription(Odometry, "fused/odometry", self.fused.append, RESUMABLE)
        for topic, kind in INNER.items():
            keep = partial(self.newest.__setitem__, topic)
            self.player.create_subscription(kind, topic, keep, RESUMABLE)
        self.player.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 10)
        self._sent = {
            name: (self.player.create_publisher(kind, name, qos), [0])
            for name, kind, qos in (
                ("imu/data_raw", Imu, SENSOR),
                ("left/camera_info", CameraInfo, STATE),
                ("stereo_features", StereoFeaturesMsg, RESUMABLE),
                ("initial_state", NavigationState, LATCHED),
            )
        }
        self._clock = self.player.create_publisher(Clock, "/clock", 10)
        self.executor = SingleThreadedExecutor()
        for node in (*self.nodes, self.player):
            self.executor.add_node(node)
        publishers = [publisher for publisher, _ in self._sent.values()]
        assert self.spin(lambda: all(p.get_subscription_count() for p in publishers))
        assert self.spin(lambda: self.backend._joint.get_subscription_count() and self._answers() == 2)

    @property
    def nodes(self) -> tuple[VehicleNode, ...]:
        """The nodes of the vehicle."""
        return self.ins, self.backend, self.fusion

    def _answers(self) -> int:
        return sum(self.player.count_publishers(f"/uav1/{name}") for name in ("odometry", "fused/odometry"))

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        self.statuses |= {status.name.split(": ")[1]: status for status in message.status}

    def spin(self, until: Callable[[], Any], *, alive: Callable[[], bool] | None = None) -> bool:
        """Run all nodes until a condition holds; return whether it does. `alive` as for `wait_for`."""
        return wait_for(until, lambda: self.executor.spin_once(timeout_sec=0.02), alive=alive)

    def send(self, name: str, message: Any) -> None:
        """Publish an input."""
        publisher, count = self._sent[name]
        publisher.publish(message)
        count[0] += 1

    def arrived(self) -> bool:
        """Return whether each node has received all that was published for it."""
        received: dict[str, set[int]] = {}
        for node in self.nodes:
            for one in node._inputs:
                received.setdefault(one.topic, set()).add(one.received)
        return all(received[name] == {count} for name, (_, (count,)) in self._sent.items())

    def start(self, offset_s: float = 0.0) -> None:
        """Publish the start state, its stamp moved."""
        state = self._vehicle.initial.state
        moved = dataclasses.replace(state, stamp_ns=state.stamp_ns + round(offset_s * NS_PER_S))
        initial = NavEstimate(moved, self._vehicle.initial.covariance)
        self.send("initial_state", navigation_to_msg(initial, frame_id="uav1/map", child_frame_id="uav1/base_link"))
        assert self.spin(self.arrived)

    def fly(self, first: int = 0, last: int | None = None, *, imu_s: float = 0.0, images_s: float = 0.0) -> None:
        """Publish frames and the readings up to each, the stamps of either moved, and the clock of the images."""
        frames = self.features[first:last]
        begin_ns = self.features[first - 1].stamp_ns if first else 0
        samples = [s for s in self._vehicle.imu.samples() if begin_ns < s.stamp_ns]
        for features in frames:
            while samples and samples[0].stamp_ns <= features.stamp_ns + NS_PER_S // 200:
                self._read(samples.pop(0), round(imu_s * NS_PER_S))
            self._show(features, round(images_s * NS_PER_S))
            assert self.spin(self.arrived)
        self.settle()

    def disturb(self, node: VehicleNode, topic: str, offset_s: int) -> None:
        """Give a node the newest message of a topic again, stamped wrongly."""
        message = copy.deepcopy(self.newest[topic])
        message.header.stamp.sec += offset_s
        (one,) = (one for one in node._inputs if one.topic == topic)
        one.callback(message)

    def settle(self) -> None:
        """Run the nodes until nothing comes any more."""
        counts: list[tuple[int, int]] = []
        for _ in range(40):
            self.executor.spin_once(timeout_sec=0.005)
            counts.append((len(self.odometry), len(self.fused)))
        if counts[0] != counts[-1]:
            self.settle()

    def _read(self, sample: ImuSample, offset_ns: int) -> None:
        message = Imu(header=header(sample.stamp_ns + offset_ns, self.ins.base_frame))
        message.angular_velocity.x, message.angular_velocity.y, message.angular_velocity.z = sample.gyro
        message.linear_acceleration.x, message.linear_acceleration.y, message.linear_acceleration.z = sample.accel
        self.send("imu/data_raw", message)

    def _show(self, features: StereoFeatures, offset_ns: int) -> None:
        shown = dataclasses.replace(features, stamp_ns=features.stamp_ns + offset_ns)
        self._clock.publish(Clock(clock=stamp_from_ns(shown.stamp_ns)))
        self.send("left/camera_info", CameraInfo(header=header(shown.stamp_ns, "left_optical")))
        self.send("stereo_features", features_to_msg(shown, frame_id="left_optical", size=self._size))

    def destroy_node(self) -> None:
        """Destroy the nodes."""
        for node in (*self.nodes, self.player):
            node.destroy_node()
