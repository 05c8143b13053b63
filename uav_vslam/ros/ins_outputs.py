# SPDX-License-Identifier: Apache-2.0
"""The INS's estimates as messages: corrected odometry with its transforms, and dead reckoning."""

from geometry_msgs.msg import TransformStamped
from nav_msgs.msg import Odometry
from tf2_msgs.msg import TFMessage

from uav_vslam.ins.body_twist import body_twist
from uav_vslam.ins.live_odometry import LiveOdometry
from uav_vslam.ros.convert import transform_to_msg
from uav_vslam.ros.odometry_data import OdometryData
from uav_vslam.ros.qos import STATE
from uav_vslam.ros.vehicle_node import VehicleNode
from uav_vslam.types import ImuIncrement, NavEstimate


class InsOutputs:
    """Publishes what there are subscribers for."""

    def __init__(self, node: VehicleNode) -> None:
        """Advertise the topics."""
        self._node = node
        self._dead_reckoning = node.advertise(Odometry, "ins/dead_reckoning", STATE)
        self._odometry = node.advertise(Odometry, "ins/odometry", STATE)
        self._tf = node.advertise(TFMessage, "/tf", STATE)
        self._data = OdometryData(frame_id=node.map_frame, child_frame_id=node.base_frame)
        self._transforms: list[TransformStamped] = []  # not published yet

    def publish_odometry(self, live: LiveOdometry) -> None:
        """Publish the newest odometry; its transforms wait for `publish_transforms`."""
        if self._odometry.get_subscription_count():
            self._odometry.publish(self._serialised(live.estimate, live.increment))
        if self._tf.get_subscription_count():
            node, stamp_ns, odom = self._node, live.estimate.state.stamp_ns, self._node.odom_frame
            jumps = transform_to_msg(live.T_map_odom, stamp_ns=stamp_ns, parent=node.map_frame, child=odom)
            motion = transform_to_msg(live.T_odom_body, stamp_ns=stamp_ns, parent=odom, child=node.base_frame)
            self._transforms += [jumps, motion]

    def publish_transforms(self) -> None:
        """Publish the transforms of a batch at once: where a machine is behind, each message may wait for readers."""
        if self._transforms:
            self._tf.publish(TFMessage(transforms=self._transforms))
            self._transforms = []

    def publish_dead_reckoning(self, nav: NavEstimate, increment: ImuIncrement | None) -> None:
        """Publish a dead-reckoned state, with the motion that led to it; None at the start."""
        if self._dead_reckoning.get_subscription_count():
            self._dead_reckoning.publish(self._serialised(nav, increment))

    def _serialised(self, nav: NavEstimate, increment: ImuIncrement | None) -> bytes:
        return self._data.of(nav.pose, body_twist(nav, increment))
