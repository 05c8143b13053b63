# SPDX-License-Identifier: Apache-2.0
"""slam_backend: features and increments to own-only odometry and map.

in   stereo_features                       uav_vslam_msgs/StereoFeatures
     ins/increment                         uav_vslam_msgs/InsIncrement
     initial_state                         uav_vslam_msgs/NavigationState, latched
     left/camera_info, right/camera_info, /tf_static    the rig
out  odometry                              nav_msgs/Odometry per frame, map frame
     path                                  nav_msgs/Path at epochs, map frame
     landmarks                             sensor_msgs/PointCloud2 at epochs, map frame
     joint_information                     uav_vslam_msgs/JointInformation at epochs, for the own fusion node
     slam/correction                       uav_vslam_msgs/NavigationState per frame, for the INS
     /tf                                   <vehicle>/map to <vehicle>/odom
"""

import time
from collections import deque
from dataclasses import dataclass

from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry, Path
from sensor_msgs.msg import PointCloud2
from tf2_msgs.msg import TFMessage

from uav_vslam.ins.propagation import propagate
from uav_vslam.ros.calibration import RigListener
from uav_vslam.ros.convert import (
    cloud_to_msg,
    features_from_msg,
    header,
    increment_from_msg,
    joint_to_msg,
    navigation_from_msg,
    navigation_to_msg,
    odometry_to_msg,
    pose_to_msg,
    transform_to_msg,
)
from uav_vslam.ros.qos import LATCHED, STATE
from uav_vslam.ros.runtime import VehicleNode, run_node
from uav_vslam.slam.backend import FrameReport, SlamBackend, crosses_epoch
from uav_vslam.slam.frame_queue import FrameQueue
from uav_vslam.types import ImuIncrement, NavEstimate, NavState, StereoFeatures
from uav_vslam.types import JointInformation as Joint
from uav_vslam_msgs.msg import InsIncrement, JointInformation, NavigationState
from uav_vslam_msgs.msg import StereoFeatures as StereoFeaturesMsg

MAX_PATH = 2000  # poses in a published path


@dataclass(slots=True)
class _Running:
    """What exists once start state and rig are known."""

    backend: SlamBackend
    reckoned: NavState  # dead reckoning, for the edge map -> odom


class SlamBackendNode(VehicleNode):
    """Joins features with increments and runs `SlamBackend`."""

    def __init__(self) -> None:
        super().__init__("slam_backend")
        self._session: int = self.declare_parameter("session", 0).value or time.time_ns() // 1_000_000
        self._initial: NavEstimate | None = None
        self._running: _Running | None = None
        self._queue = FrameQueue()
        self._previous_ns: int | None = None
        self._path: deque[PoseStamped] = deque(maxlen=MAX_PATH)
        self._odometry = self.advertise(Odometry, "odometry", STATE)
        self._paths = self.advertise(Path, "path", STATE)
        self._landmarks = self.advertise(PointCloud2, "landmarks", STATE)
        self._joint = self.advertise(JointInformation, "joint_information", STATE)
        self._correction = self.advertise(NavigationState, "slam/correction", STATE)
        self._tf = self.advertise(TFMessage, "/tf", STATE)
        self._rig = RigListener(self, self._work)
        self.listen(NavigationState, "initial_state", self._on_initial_state, LATCHED)
        self.listen(InsIncrement, "ins/increment", self._on_increment, STATE)
        self.listen(StereoFeaturesMsg, "stereo_features", self._on_features, STATE)

    def _on_initial_state(self, message: NavigationState) -> None:
        if self._initial is None:
            self._initial = navigation_from_msg(message)
            self._queue.start_ns = self._initial.state.stamp_ns
            self._work()

    def _on_increment(self, message: InsIncrement) -> None:
        self._queue.add_increment(increment_from_msg(message))
        self._work()

    def _on_features(self, message: StereoFeaturesMsg) -> None:
        self._queue.add_features(features_from_msg(message))
        self._work()

    def _work(self) -> None:
        """Process every frame whose features and motion have both come."""
        if self._running is None:
            if self._initial is None or self._rig.rig is None:
                return
            backend = SlamBackend(
                self._initial, rig=self._rig.rig, config=self.config, vehicle=self.vehicle, session=self._session
            )
            self._running = _Running(backend, self._initial.state)
        while (frame := self._queue.pop()) is not None:
            self._process(self._running, *frame)
        self.counts["dropped/before_start"] = self._queue.before_start
        self.counts["dropped/frame_lost"] = self._queue.lost
        self.counts["dropped/without_motion"] = self._queue.without_motion

    def _process(self, running: _Running, features: StereoFeatures, increment: ImuIncrement | None) -> None:
        report = running.backend.process(features, increment)
        if increment is not None:
            running.reckoned = propagate(running.reckoned, increment, gravity=self.config.imu.gravity)
        self._count(report)
        if crosses_epoch(self._previous_ns, features.stamp_ns, self.config.fusion.epoch_s):
            self._publish_epoch(running.backend.joint_information())
        self._previous_ns = features.stamp_ns
        self._publish_frame(report, running.reckoned)

    def _publish_epoch(self, joint: Joint) -> None:
        """Publish what is large, before the frame's odometry, for which the fusion waits with it."""
        self._joint.publish(joint_to_msg(joint, frame_id=self.map_frame))
        self._landmarks.publish(cloud_to_msg(joint.positions, stamp_ns=joint.stamp_ns, frame_id=self.map_frame))
        self._paths.publish(Path(header=header(joint.stamp_ns, self.map_frame), poses=list(self._path)))

    def _publish_frame(self, report: FrameReport, reckoned: NavState) -> None:
        pose, state = report.pose, report.nav.state
        self._correction.publish(navigation_to_msg(report.nav, frame_id=self.map_frame, child_frame_id=self.base_frame))
        T_map_odom = pose.T_map_body @ reckoned.T_map_body.inverse()
        edge = transform_to_msg(T_map_odom, stamp_ns=pose.stamp_ns, parent=self.map_frame, child=self.odom_frame)
        self._tf.publish(TFMessage(transforms=[edge]))
        self._path.append(PoseStamped(header=header(pose.stamp_ns, self.map_frame), pose=pose_to_msg(pose.T_map_body)))
        self._odometry.publish(
            odometry_to_msg(pose, frame_id=self.map_frame, child_frame_id=self.base_frame, velocity_map=state.v_map)
        )

    def _count(self, report: FrameReport) -> None:
        self.counts["frames"] += 1
        self.counts["frames_coasted"] += report.associated == 0
        self.counts["relocalisations"] += report.relocalised
        self.notes["landmarks"] = str(report.landmarks)
        self.notes["associated"] = str(report.associated)
        if report.innovation is not None:
            self.notes["nis_per_dof"] = f"{report.innovation.nis / max(report.innovation.dof, 1):.2f}"


def main(args: list[str] | None = None) -> int:
    """Entry point."""
    return run_node(SlamBackendNode, args)


if __name__ == "__main__":
    raise SystemExit(main())
