# SPDX-License-Identifier: Apache-2.0
"""fusion: the own belief and the peers' packets to fused odometry; the only node that talks to other vehicles.

in   joint_information                     uav_vslam_msgs/JointInformation, own host only
     odometry                              nav_msgs/Odometry, own-only
     /<peer>/landmark_information          uav_vslam_msgs/LandmarkInformation, every peer's
out  landmark_information                  uav_vslam_msgs/LandmarkInformation at epochs: all that leaves the vehicle
     fused/odometry                        nav_msgs/Odometry per frame, world frame
     fused/path, fused/landmarks           nav_msgs/Path, sensor_msgs/PointCloud2 at epochs, world frame
     fusion/status                         uav_vslam_msgs/FusionStatus at epochs
     /tf                                   world to <vehicle>/map
"""

from collections import deque
from functools import partial

from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry, Path
from sensor_msgs.msg import PointCloud2
from tf2_msgs.msg import TFMessage

from uav_vslam.cooperation.fusion import Fusion
from uav_vslam.errors import InvalidMessage
from uav_vslam.ros.convert import (
    cloud_to_msg,
    header,
    joint_from_msg,
    odometry_from_msg,
    odometry_to_msg,
    packet_from_msg,
    packet_to_msg,
    pose_to_msg,
    transform_to_msg,
)
from uav_vslam.ros.qos import STATE, WIDEBAND
from uav_vslam.ros.runtime import VehicleNode, run_node
from uav_vslam.slam.backend import crosses_epoch
from uav_vslam.types import NS_PER_S, JointInformation, PoseEstimate
from uav_vslam_msgs.msg import FusionStatus, LandmarkInformation, PeerLink
from uav_vslam_msgs.msg import JointInformation as JointInformationMsg

WORLD = "world"
MAX_WAITING = 20  # odometry held for an epoch's joint information; then the epoch is given up
MAX_PATH = 2000  # poses in a published path


class FusionNode(VehicleNode):
    """Feeds `Fusion` in stamp order: an epoch's joint information before the odometry of the same stamp."""

    def __init__(self) -> None:
        super().__init__("fusion")
        peers = [p for p in self.declare_parameter("peers", [""]).value if p and p != self.vehicle]
        self._fusion = Fusion(self.vehicle, self.config.fusion)
        self._joints: dict[int, JointInformation] = {}
        self._waiting: deque[PoseEstimate] = deque()
        self._previous_ns: int | None = None
        self._path: deque[PoseStamped] = deque(maxlen=MAX_PATH)
        self._packets = self.advertise(LandmarkInformation, "landmark_information", WIDEBAND)
        self._odometry = self.advertise(Odometry, "fused/odometry", STATE)
        self._paths = self.advertise(Path, "fused/path", STATE)
        self._landmarks = self.advertise(PointCloud2, "fused/landmarks", STATE)
        self._status = self.advertise(FusionStatus, "fusion/status", STATE)
        self._tf = self.advertise(TFMessage, "/tf", STATE)
        self.listen(JointInformationMsg, "joint_information", self._on_joint, STATE)
        self.listen(Odometry, "odometry", self._on_odometry, STATE)
        if self.config.fusion.mode != "none":
            for peer in peers:
                topic = f"/{peer}/landmark_information"
                self.listen(LandmarkInformation, topic, partial(self._on_packet, peer), WIDEBAND)

    def _on_packet(self, peer: str, message: LandmarkInformation) -> None:
        if message.vehicle != peer:
            raise InvalidMessage("sender", f"{peer}'s topic carries a packet of {message.vehicle!r}")
        self._fusion.inbox.add(packet_from_msg(message))

    def _on_joint(self, message: JointInformationMsg) -> None:
        joint = joint_from_msg(message)
        self._joints[joint.stamp_ns] = joint
        self._work()

    def _on_odometry(self, message: Odometry) -> None:
        self._waiting.append(odometry_from_msg(message))
        self._work()

    def _work(self) -> None:
        while self._waiting:
            own = self._waiting[0]
            if crosses_epoch(self._previous_ns, own.stamp_ns, self.config.fusion.epoch_s):
                joint = self._joints.pop(own.stamp_ns, None)
                if joint is not None:
                    self._run_epoch(joint)
                elif len(self._waiting) < MAX_WAITING:
                    return
                else:
                    self.drop("joint_lost", f"no joint information came for the epoch at {own.stamp_ns} ns")
            self._previous_ns = own.stamp_ns
            self._publish_pose(own, self._fusion.carry(self._waiting.popleft()))

    def _run_epoch(self, joint: JointInformation) -> None:
        epoch = self._fusion.fuse(joint)
        if self.config.fusion.mode != "none":
            self._packets.publish(packet_to_msg(self._fusion.packet(joint), frame_id=self.map_frame))
        stamp_ns = joint.stamp_ns
        self._landmarks.publish(cloud_to_msg(epoch.positions, stamp_ns=stamp_ns, frame_id=WORLD))
        self._paths.publish(Path(header=header(stamp_ns, WORLD), poses=list(self._path)))
        self._status.publish(self._status_message(stamp_ns, epoch.weight))

    def _publish_pose(self, own: PoseEstimate, fused: PoseEstimate) -> None:
        T_world_map = fused.T_map_body @ own.T_map_body.inverse()
        edge = transform_to_msg(T_world_map, stamp_ns=own.stamp_ns, parent=WORLD, child=self.map_frame)
        self._tf.publish(TFMessage(transforms=[edge]))
        self._path.append(PoseStamped(header=header(fused.stamp_ns, WORLD), pose=pose_to_msg(fused.T_map_body)))
        self._odometry.publish(odometry_to_msg(fused, frame_id=WORLD, child_frame_id=self.base_frame))

    def _status_message(self, stamp_ns: int, weight: float) -> FusionStatus:
        self.notes["peers"] = str(len(self._fusion.inbox.peers))
        return FusionStatus(
            header=header(stamp_ns, WORLD),
            vehicle=self.vehicle,
            mode=self.config.fusion.mode,
            own_weight=weight,
            packets_sent=self._fusion.packets_sent,
            bytes_sent=self._fusion.bytes_sent,
            sent_bytes_per_s=self._fusion.sent_bytes_per_s,
            peers=[self._peer_message(name, stamp_ns) for name in sorted(self._fusion.inbox.peers)],
        )

    def _peer_message(self, name: str, stamp_ns: int) -> PeerLink:
        record = self._fusion.inbox.peers[name]
        newest = record.packets[-1] if record.packets else None
        return PeerLink(
            peer=name,
            session=newest.session if newest else 0,
            last_sequence=newest.sequence if newest else 0,
            packets_received=record.received,
            packets_used=len(record.used),
            drop_reasons=list(record.dropped),
            drop_counts=list(record.dropped.values()),
            common_landmarks=record.common_landmarks,
            age_s=(stamp_ns - newest.stamp_ns) / NS_PER_S if newest else 0.0,
        )


def main(args: list[str] | None = None) -> int:
    """Entry point."""
    return run_node(FusionNode, args)


if __name__ == "__main__":
    raise SystemExit(main())
