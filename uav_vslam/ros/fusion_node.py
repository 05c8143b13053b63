# SPDX-License-Identifier: Apache-2.0
"""fusion: the own belief and the peers' packets to fused odometry; the only node that talks to other vehicles.

in   joint_information                     uav_vslam_msgs/JointInformation, own host only
     odometry                              nav_msgs/Odometry, own-only
     /<peer>/landmark_information          uav_vslam_msgs/LandmarkInformation, every peer's, over the radio
     /<vehicle>/fusion/feedback            the same type, peers' estimates of own landmarks (fusion.feedback)
out  /<vehicle>/landmark_information       uav_vslam_msgs/LandmarkInformation at epochs: all that leaves the vehicle
     /<peer>/fusion/feedback               ... except this (wideband, with fusion.feedback)
     fused/odometry                        nav_msgs/Odometry per frame, world frame
     fused/path, fused/landmarks           nav_msgs/Path, sensor_msgs/PointCloud2 at epochs, world frame
     fusion/status                         uav_vslam_msgs/FusionStatus at epochs
     /tf                                   world to <vehicle>/map; without a common origin (fusion.common_origin)
                                           world is the own map, and world to <peer>/map is estimated
"""

from collections import deque
from typing import Any

from geometry_msgs.msg import PoseStamped, TwistWithCovariance
from nav_msgs.msg import Odometry, Path
from sensor_msgs.msg import PointCloud2
from tf2_msgs.msg import TFMessage

from uav_vslam.config import VehicleConfig
from uav_vslam.cooperation.exchange import Exchange
from uav_vslam.cooperation.fused_pose import FusedEpoch
from uav_vslam.cooperation.fusion import Fusion
from uav_vslam.cooperation.peer_faults import clocks_ahead, contradictions, namesake_fault, peer_faults
from uav_vslam.errors import InvalidMessage
from uav_vslam.ros.convert import (
    cloud_to_msg,
    header,
    joint_from_msg,
    odometry_from_msg,
    odometry_to_msg,
    pose_to_msg,
    transform_to_msg,
)
from uav_vslam.ros.fusion_status import StatusReporter, account
from uav_vslam.ros.qos import NEWEST, STATE
from uav_vslam.ros.radio import Radio
from uav_vslam.ros.radio_participant import open_participant
from uav_vslam.ros.runtime import run_node
from uav_vslam.ros.traffic import Interface
from uav_vslam.ros.vehicle_node import MAX_PATH, VehicleNode
from uav_vslam.slam.epochs import crosses_epoch
from uav_vslam.slam.saved_map import load_map
from uav_vslam.stamps import IMAGE_TIME_JUMP_S, TimeLine
from uav_vslam.types import JointInformation, PoseEstimate
from uav_vslam_msgs.msg import FusionStatus
from uav_vslam_msgs.msg import JointInformation as JointInformationMsg

Own = tuple[PoseEstimate, TwistWithCovariance]

ODOMETRY, JOINT = "odometry", "joint_information"
CONFIRMING = 3  # messages of each that confirm a jump: joint information comes once a second
MAX_WAITING = 20  # odometry held for an epoch's joint information; then the epoch is skipped
MAX_JOINTS = 8  # epochs' joint information that waits for its odometry: the back end sends it just before


class FusionNode(VehicleNode):
    """Feeds `Fusion` in stamp order: an epoch's joint information before the odometry of the same stamp."""

    def __init__(self, args: list[str] | None = None) -> None:
        """Make it.

        Args:
            args: command line, which may name a radio; None for that of the process.
        """
        self._participant = open_participant("fusion", args)
        super().__init__("fusion")
        # The back end never goes back within a session: older stamps are those of one that was restarted.
        follow = self.config.input.on_time_jump != "refuse"
        streams = {ODOMETRY: IMAGE_TIME_JUMP_S, JOINT: IMAGE_TIME_JUMP_S}
        self._stamps: TimeLine[Any] = TimeLine(
            streams, follow=follow, back=False, least=CONFIRMING, most={JOINT: MAX_JOINTS}
        )
        self._session: int | None = None
        self._forget_flight()
        map_file = self.config.start.map
        self._fusion = Fusion(self.vehicle, self.config.fusion, load_map(map_file) if map_file else None)
        self._odometry = self.advertise(Odometry, "fused/odometry", NEWEST)
        self._paths = self.advertise(Path, "fused/path", STATE)
        self._landmarks = self.advertise(PointCloud2, "fused/landmarks", STATE)
        self._status = self.advertise(FusionStatus, "fusion/status", STATE)
        self._tf = self.advertise(TFMessage, "/tf", STATE)
        self.listen(JointInformationMsg, "joint_information", self._on_joint, NEWEST)
        self._own_odometry = self.listen(Odometry, "odometry", self._on_odometry, NEWEST)
        if self._participant is not None:
            self._participant.serve(self)
        peers = [peer for peer in self.own.peers if peer != self.vehicle]  # vehicles may share a list of all
        host = self._participant.node if self._participant else None
        self._radio = Radio(self, peers, host=host)
        self._exchange = Exchange(self._fusion, peers, self._radio, self.config.fusion, on_drop=self.drop)
        self._interface = Interface(self.own.radio_interface) if self.own.radio_interface else None
        self._reporter = StatusReporter(self.vehicle, self._fusion, self._exchange, self._interface)
        self._exchange.configure(self.config.fusion)

    def _forget_flight(self) -> None:
        """Forget what belongs to one session of the back end."""
        self._begin_ns: int | None = None  # while odometry is skipped: stamp of the first of the session
        self._joints: dict[int, JointInformation] = {}
        self._waiting: deque[Own] = deque()
        self._first_ns: int | None = None  # stamps of the odometry used
        self._previous_ns: int | None = None
        self._path: deque[PoseStamped] = deque(maxlen=MAX_PATH)

    def reset(self) -> None:
        """Start again with the next epoch; packets of peers that are known stay refused."""
        self._session = None
        self._stamps.restart()
        self._forget_flight()
        self._fusion.restart()
        self._exchange.restart()

    def configure(self, config: VehicleConfig) -> None:
        """Apply changed live settings."""
        self._exchange.configure(config.fusion)

    def destroy_node(self) -> None:
        """Leave the radio, then the vehicle's graph."""
        if self._participant is not None:
            self._participant.close()
        super().destroy_node()

    def _on_joint(self, message: JointInformationMsg) -> None:
        joint = joint_from_msg(message)
        if self._session is not None and joint.session > self._session:
            self.get_logger().warning(f"the back end started again: session {joint.session}")
            self.reset()
            self._begin_ns = joint.stamp_ns
        self._session = max(joint.session, self._session or 0)
        if self._first_ns is not None and joint.stamp_ns < self._first_ns:
            return  # kept for late joiners: of an epoch before this node, or this flight, began
        if self._previous_ns is not None and joint.stamp_ns <= self._previous_ns:
            raise InvalidMessage("joint_late", f"joint information of {joint.stamp_ns} ns, after its odometry")
        if joint.stamp_ns in self._joints:  # a restarted back end repeats it under the identifiers that it goes on with
            self._joints[joint.stamp_ns] = joint
            return
        self._feed(JOINT, joint.stamp_ns, joint)
        if self._begin_ns is not None:
            self._own_odometry.take_waiting(self)  # the last frames of the session before may wait still
            self._begin_ns = None
        if len(self._joints) > MAX_JOINTS:
            last_ns = max(self._joints)  # a wrong stamp must not keep out the ones that are due
            del self._joints[last_ns]
            raise InvalidMessage("joint_early", f"{MAX_JOINTS} wait for odometry; that of {last_ns} ns is too early")

    def _on_odometry(self, message: Odometry) -> None:
        pose = odometry_from_msg(message)
        if self._begin_ns not in (None, pose.stamp_ns):
            return
        self._begin_ns = None
        self._feed(ODOMETRY, pose.stamp_ns, (pose, message.twist))

    def _feed(self, name: str, stamp_ns: int, item: JointInformation | Own) -> None:
        admitted = self._stamps.add(name, stamp_ns, item)
        self.report_clock(self._stamps, str(admitted.jump or ""))
        for _, each in admitted.items:
            if isinstance(each, JointInformation):
                self._joints[each.stamp_ns] = each
            else:
                self._waiting.append(each)
            self._work()

    def _work(self) -> None:
        while self._waiting:
            own, twist = self._waiting[0]
            is_epoch = crosses_epoch(self._previous_ns, own.stamp_ns, self.config.fusion.epoch_s)
            joint = self._joints.get(own.stamp_ns) if is_epoch else None
            if is_epoch and joint is None and not self._is_joint_lost():
                return
            self._waiting.popleft()
            self._first_ns = own.stamp_ns if self._first_ns is None else self._first_ns
            self._previous_ns = own.stamp_ns
            self._joints = {stamp_ns: later for stamp_ns, later in self._joints.items() if stamp_ns > own.stamp_ns}
            if joint is not None:
                self.guarded("joint_information", self._run_epoch)(joint)  # if it fails, propagation goes on
            elif is_epoch:
                self.drop("joint_lost", f"no joint information arrived for the epoch at {own.stamp_ns} ns")
            self._publish_pose(own, self._fusion.propagate(own), twist)

    def _is_joint_lost(self) -> bool:
        """Return whether the joint information that the oldest odometry waits for will not come any more.

        The back end sends that of each epoch in turn: a later one is there, or it is long overdue.
        """
        overtaken = any(later.stamp_ns in self._joints for later, _ in self._waiting)
        return overtaken or len(self._waiting) >= MAX_WAITING

    def _run_epoch(self, joint: JointInformation) -> None:
        epoch = self._fusion.fuse(joint)
        self._exchange.send()
        self.notes |= {"map_landmarks": str(epoch.map_landmarks), "loose_landmarks": str(self._fusion.loose)}
        stamp_ns = joint.stamp_ns
        self._publish_frames(stamp_ns, epoch)
        self._landmarks.publish(cloud_to_msg(epoch.positions, stamp_ns=stamp_ns, frame_id=self.world_frame))
        self._paths.publish(Path(header=header(stamp_ns, self.world_frame), poses=list(self._path)))
        self._report(stamp_ns, epoch)

    def _publish_pose(self, own: PoseEstimate, fused: PoseEstimate, twist: TwistWithCovariance) -> None:
        """Publish the fused pose; the twist, in the body frame, is the own one: packets hold no velocities."""
        T_world_map = fused.T_map_body @ own.T_map_body.inverse()
        edge = transform_to_msg(T_world_map, stamp_ns=own.stamp_ns, parent=self.world_frame, child=self.map_frame)
        self._tf.publish(TFMessage(transforms=[edge]))
        self._path.append(
            PoseStamped(header=header(fused.stamp_ns, self.world_frame), pose=pose_to_msg(fused.T_map_body))
        )
        self._odometry.publish(odometry_to_msg(fused, twist, frame_id=self.world_frame, child_frame_id=self.base_frame))

    def _publish_frames(self, stamp_ns: int, epoch: FusedEpoch) -> None:
        """Publish the frames of peers without a common origin; the diagnostics say why one is unknown.

        Each vehicle has names of its own for them: the peer may publish the frame itself, with another parent.
        """
        own, world = self.vehicle, self.world_frame
        edges = [
            transform_to_msg(frame.T_own_peer, stamp_ns=stamp_ns, parent=world, child=f"{own}/{peer}/map")
            for peer, frame in epoch.frames.items()
        ]
        if edges:
            self._tf.publish(TFMessage(transforms=edges))
        if not self.config.fusion.common_origin:
            self.notes |= {f"frame/{peer}": self._fusion.frame(peer).reason or "found" for peer in epoch.common}

    def _report(self, stamp_ns: int, epoch: FusedEpoch) -> None:
        before = set(self._reporter.silent)
        status = self._reporter.report(stamp_ns, self.world_frame, own_weight=epoch.weight)
        self._status.publish(status)
        self._report_faults(epoch)
        for peer in sorted(before - self._reporter.silent.keys()):
            self.get_logger().info(f"{peer} is received again")
        for peer in sorted(self._reporter.silent.keys() - before):
            self.get_logger().warning(f"{peer} is silent")
        self.notes["peers"] = str(len(status.peers))
        self.notes["sent_bytes_per_s"] = f"{status.recent_bytes_per_s:.0f}"
        if status.radio_interface:
            self.notes["wire_sent_bytes_per_s"] = f"{status.wire_sent_bytes_per_s:.0f}"
        self.notes |= {f"received_bytes_per_s/{link.peer}": f"{link.received_bytes_per_s:.0f}" for link in status.peers}
        self.notes |= {f"packets/{link.peer}": account(link) for link in status.peers}
        self._note_clocks()

    def _note_clocks(self) -> None:
        """Note whose clock is far ahead; log the onset."""
        ahead = clocks_ahead(self._fusion.inbox)
        for subject in sorted(ahead.keys() - self.notes.keys()):
            self.get_logger().info(ahead[subject])
        self.notes = {name: text for name, text in self.notes.items() if not name.startswith("clock/")} | ahead

    def _report_faults(self, epoch: FusedEpoch) -> None:
        """Report a radio that is down, silent peers, and what is wrong with others; log the onset."""
        self._radio.look_for_namesake()
        is_down = self._interface is not None and self._interface.is_down
        radio = {"radio": f"radio interface {self.own.radio_interface} is down"} if is_down else {}
        faults = radio | peer_faults(self._fusion.inbox) | contradictions(epoch)
        for subject in sorted(faults.keys() - self.alarms.keys()):
            self.get_logger().warning(faults[subject])
        silent = {peer: f"{peer} silent for {age_s:.0f} s" for peer, age_s in self._reporter.silent.items()}
        self.alarms = faults | silent
        self.report_failure("namesake", namesake_fault(self._fusion.inbox, self.vehicle))


def main(args: list[str] | None = None) -> int:
    """Entry point."""
    return run_node(lambda: FusionNode(args), args, shared_memory=True)  # the radio's participant shares its profile


if __name__ == "__main__":
    raise SystemExit(main())
