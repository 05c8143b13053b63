# SPDX-License-Identifier: Apache-2.0
"""slam_backend: own-only odometry and map from features and increments.

in   stereo_features                       uav_vslam_msgs/StereoFeatures
     ins/increment                         uav_vslam_msgs/InsIncrement
     initial_state                         uav_vslam_msgs/NavigationState, latched; an output instead with
                                           start.method in_flight and map
     left/camera_info, right/camera_info, /tf_static    the rig
out  odometry                              nav_msgs/Odometry per frame, map frame
     path                                  nav_msgs/Path at epochs, map frame
     landmarks                             sensor_msgs/PointCloud2 at epochs, map frame
     joint_information                     uav_vslam_msgs/JointInformation at epochs, for the own fusion node
     slam/correction                       uav_vslam_msgs/NavigationState per frame, for the INS
     slam/smoothed                         geometry_msgs/PoseWithCovarianceStamped per frame, map frame: the pose of
                                           backend.window frames ago as later ones have corrected it
     slam/quality                          uav_vslam_msgs/FrameQuality per frame, for evaluation without ground truth
srv  ~/reset, ~/pause                      see lifecycle.py
     ~/save_map                            std_srvs/Trigger: all landmarks mapped so far, into the parameter map_file
     ~/load_map                            std_srvs/Trigger: the map of map_file, to start in (start.method map)
"""

from collections import deque

from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
from nav_msgs.msg import Odometry, Path
from sensor_msgs.msg import PointCloud2

from uav_vslam.config import VehicleConfig
from uav_vslam.errors import ConfigError
from uav_vslam.ins.body_twist import body_twist
from uav_vslam.monitor import DROPPED
from uav_vslam.ros.backend_status import BackendStatus
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
    pose_with_covariance_to_msg,
    twist_to_msg,
)
from uav_vslam.ros.map_services import offer_map_services
from uav_vslam.ros.qos import LATCHED, MOTION, NEWEST, RESUMABLE, STATE
from uav_vslam.ros.quality_message import quality_to_msg
from uav_vslam.ros.runtime import run_node
from uav_vslam.ros.vehicle_node import MAX_PATH, VehicleNode
from uav_vslam.slam.checkpoint import checkpoint_file, load_checkpoint, save_checkpoint
from uav_vslam.slam.clocked_stage import ClockedStage
from uav_vslam.slam.frame_output import FrameOutput
from uav_vslam.slam.session import next_session
from uav_vslam.slam.stage import SlamStage
from uav_vslam.slam.state_folder import state_folder
from uav_vslam.types import NS_PER_S, NavEstimate
from uav_vslam.types import JointInformation as Joint
from uav_vslam_msgs.msg import FrameQuality, InsIncrement, JointInformation, NavigationState
from uav_vslam_msgs.msg import StereoFeatures as StereoFeaturesMsg


class SlamBackendNode(VehicleNode):
    """Runs `SlamStage`."""

    def __init__(self) -> None:
        super().__init__("slam_backend")
        self._checkpoint = checkpoint_file(state_folder(), self.vehicle)
        self._saved_ns: int | None = None
        self._given: tuple[NavEstimate, str] | None = None  # the newest start state received, and its frame
        self._clocked = ClockedStage(self._resumed() or self._fresh(), self.config, self._next_session)
        self._status = BackendStatus(self)
        self._path: deque[PoseStamped] = deque(maxlen=MAX_PATH)
        self._odometry = self.advertise(Odometry, "odometry", NEWEST)
        self._paths = self.advertise(Path, "path", STATE)
        self._landmarks = self.advertise(PointCloud2, "landmarks", STATE)
        self._joint = self.advertise(JointInformation, "joint_information", NEWEST)
        self._correction = self.advertise(NavigationState, "slam/correction", NEWEST)
        self._smoothed = self.advertise(PoseWithCovarianceStamped, "slam/smoothed", STATE)
        self._quality = self.advertise(FrameQuality, "slam/quality", STATE)
        self._rig = RigListener(self, self._work)
        self._finds_start = self.config.start.searches
        if self._finds_start:
            self._initial_state = self.advertise(NavigationState, self.config.input.topics.initial_state, LATCHED)
        else:
            self.listen(NavigationState, self.config.input.topics.initial_state, self._on_initial_state, LATCHED)
        self.listen(InsIncrement, "ins/increment", self._on_increment, MOTION)
        self.listen(StereoFeaturesMsg, "stereo_features", self._on_features, RESUMABLE)
        offer_map_services(self, lambda: self._stage)

    @property
    def _stage(self) -> SlamStage:
        """The current session's."""
        return self._clocked.stage

    def _fresh(self) -> SlamStage:
        session: int = self.own.session or next_session(self.vehicle)
        return SlamStage(self.config, vehicle=self.vehicle, session=session, keep_map=True)

    def _next_session(self) -> int:
        following = self._stage.session + 1  # above all that this process has used
        try:
            return max(next_session(self.vehicle), following)
        except ConfigError as error:
            self.alarms["session"] = f"session {following} is not stored, and may be used again: {error}"
            self.get_logger().error(self.alarms["session"])
            return following

    def reset(self) -> None:
        """Start again in a new session, at whatever stamps come next."""
        self._clocked.reset()
        self._rig.restart()
        self._begin_session()

    def _begin_session(self) -> None:
        """Forget what belongs to the session before."""
        self._path.clear()
        self._status.restart()
        self._saved_ns = None
        self._finds_start = self.config.start.searches and self._stage.initial is None
        self._write_checkpoint()  # that of the session before must not be resumed
        if self._stage.initial is None and not self._finds_start:
            self.alarms["start"] = "no estimate before a new initial_state: the session began without one"
            self.get_logger().warning(self.alarms["start"])

    def _resumed(self) -> SlamStage | None:
        """Return the stage of a process that died, if asked to go on from it."""
        if not self.own.resume:
            return None
        try:
            stage = load_checkpoint(self._checkpoint, self.vehicle)
        except ConfigError as error:
            self.get_logger().error(f"{error}; the vehicle starts again from its start state")
            return None
        stage.configure(self.config)
        reached = "before its first frame" if stage.stamp_ns is None else f"at {stage.stamp_ns} ns"
        self.get_logger().warning(f"resumed from the checkpoint {reached}, session {stage.session}")
        return stage

    def configure(self, config: VehicleConfig) -> None:
        """Apply changed live settings."""
        self._stage.configure(config)

    def _on_initial_state(self, message: NavigationState) -> None:
        given = navigation_from_msg(message)
        self._given = given, message.child_frame_id
        self._clocked.start(given)
        self._work()

    def _foreign_start(self) -> str:
        """Return why the start state that the first frame would use is not one of the body; empty if it is."""
        given, frame = self._given or (None, "")
        is_next = given is not None and self._stage.initial is given and self._stage.nav is None
        return self._rig.setup.conflict(frame) if is_next else ""

    def _on_increment(self, message: InsIncrement) -> None:
        self._follow(self._clocked.add_increment(increment_from_msg(message)))

    def _on_features(self, message: StereoFeaturesMsg) -> None:
        self._follow(self._clocked.add_features(features_from_msg(message)))

    def _follow(self, happened: str) -> None:
        """Work, in a new session if the clock has begun one."""
        if happened:
            self._begin_session()
        self.report_clock(self._clocked.line, happened)
        self._work()

    def _work(self) -> None:
        """Process every frame whose features and increment have arrived."""
        self._stage.rig = self._rig.rig or self._stage.rig  # that of a checkpoint until the cameras publish again
        if self._stage.initial is not None:
            self.alarms.pop("start", None)
        foreign = self._foreign_start()
        self.report_alarm("start_frame", f"no start: initial_state {foreign}" if foreign else "", logged=True)
        for output in () if foreign else self._stage.run():
            self._publish(output)
            self._save(output.report.pose.stamp_ns)
        for reason, count in self._clocked.dropped.items():
            self.counts[f"{DROPPED}{reason}"] = count
        waits = self._stage.rig is None and self._clocked.dropped["before_rig"]
        self.report_alarm("calibration", f"features arrive, but {self._rig.missing}" if waits else "", logged=True)
        self.report_failure("unpaired", self._stage.unpaired)
        fault = self._stage.imu_fault
        self.report_failure("imu", f"{fault}; until then the motion is that of the images alone" if fault else "")
        if self._finds_start:
            self.notes["start"] = f"searching: {self._stage.missing_start}"

    def _publish(self, output: FrameOutput) -> None:
        if self._finds_start and self._stage.initial is not None:
            self._publish_start(self._stage.initial)
        self._status.report(output)
        if output.joint is not None:
            self._publish_epoch(output.joint)
        self._quality.publish(quality_to_msg(output.quality, frame_id=self.map_frame))
        if output.report.smoothed is not None:
            self._smoothed.publish(pose_with_covariance_to_msg(output.report.smoothed, frame_id=self.map_frame))
        self._publish_frame(output)

    def _save(self, stamp_ns: int) -> None:
        """Write a checkpoint at the first frame, and once in a period of stamps."""
        if self._saved_ns is not None and stamp_ns - self._saved_ns < self.own.checkpoint_s * NS_PER_S:
            return
        self._saved_ns = stamp_ns
        self._write_checkpoint()

    def _write_checkpoint(self) -> None:
        try:
            save_checkpoint(self._checkpoint, self._stage, self.vehicle)
            self.alarms.pop("checkpoint", None)
        except OSError as error:
            self.alarms["checkpoint"] = f"{self._checkpoint} can't be written: {error.strerror}"

    def _publish_start(self, found: NavEstimate) -> None:
        """Publish the estimated start state once."""
        self._finds_start = False
        self.notes["start"] = "found in flight"
        self._initial_state.publish(navigation_to_msg(found, frame_id=self.map_frame, child_frame_id=self.base_frame))

    def _publish_epoch(self, joint: Joint) -> None:
        """Publish an epoch's belief, map and path before the odometry, on which the fusion node triggers."""
        self._joint.publish(joint_to_msg(joint, frame_id=self.map_frame))
        self._landmarks.publish(cloud_to_msg(joint.positions, stamp_ns=joint.stamp_ns, frame_id=self.map_frame))
        self._paths.publish(Path(header=header(joint.stamp_ns, self.map_frame), poses=list(self._path)))

    def _publish_frame(self, output: FrameOutput) -> None:
        report, pose = output.report, output.report.pose
        self._correction.publish(navigation_to_msg(report.nav, frame_id=self.map_frame, child_frame_id=self.base_frame))
        self._path.append(PoseStamped(header=header(pose.stamp_ns, self.map_frame), pose=pose_to_msg(pose.T_map_body)))
        twist = twist_to_msg(body_twist(report.nav, output.increment))
        self._odometry.publish(odometry_to_msg(pose, twist, frame_id=self.map_frame, child_frame_id=self.base_frame))


def main(args: list[str] | None = None) -> int:
    """Entry point."""
    return run_node(SlamBackendNode, args)


if __name__ == "__main__":
    raise SystemExit(main())
