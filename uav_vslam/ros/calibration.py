# SPDX-License-Identifier: Apache-2.0
"""The stereo rig as a node learns it: intrinsics from camera_info, extrinsics from /tf_static."""

from rclpy.logging import get_logger
from sensor_msgs.msg import CameraInfo
from tf2_msgs.msg import TFMessage

from uav_vslam.errors import CalibrationError, InvalidMessage
from uav_vslam.geometry.camera import PinholeCamera
from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.stereo import StereoRig
from uav_vslam.ros.convert import camera_from_msg, transform_from_msg
from uav_vslam.ros.qos import LATCHED, STATE
from uav_vslam.ros.runtime import VehicleNode


class RigListener:
    """Gathers what a rig consists of; `rig` is None until all of it has come."""

    def __init__(self, node: VehicleNode) -> None:
        self._node = node
        self._cameras: dict[str, tuple[PinholeCamera, str]] = {}
        self._transforms: dict[str, tuple[str, Pose]] = {}  # child frame -> (parent frame, T_parent_child)
        self.rig: StereoRig | None = None
        for side in ("left", "right"):
            node.listen(CameraInfo, f"{side}/camera_info", lambda m, s=side: self._on_camera(s, m), STATE)
        node.listen(TFMessage, "/tf_static", self._on_transforms, LATCHED)

    @property
    def left_frame(self) -> str:
        """Frame of the left camera, empty until known."""
        return self._cameras["left"][1] if "left" in self._cameras else ""

    def _on_camera(self, side: str, message: CameraInfo) -> None:
        if side in self._cameras:
            return
        self._cameras[side] = (camera_from_msg(message), message.header.frame_id)
        self._assemble()

    def _on_transforms(self, message: TFMessage) -> None:
        for transform in message.transforms:
            self._transforms[transform.child_frame_id] = (transform.header.frame_id, transform_from_msg(transform))
        self._assemble()

    def _assemble(self) -> None:
        if self.rig is not None or len(self._cameras) < 2:
            return
        (left, left_frame), (right, right_frame) = self._cameras["left"], self._cameras["right"]
        T_body_left, T_body_right = self._from_base(left_frame), self._from_base(right_frame)
        if T_body_left is None or T_body_right is None:
            return
        try:
            self.rig = StereoRig(left, right, T_body_left, T_body_right)
        except CalibrationError as error:
            raise InvalidMessage("calibration", str(error)) from None
        get_logger(self._node.get_name()).info(f"rig complete: baseline {self.rig.baseline_m:.3f} m")

    def _from_base(self, frame: str) -> Pose | None:
        """Return T_base_frame by walking up the tree; None while an edge is unknown."""
        pose, steps = Pose.identity(), 0
        while frame != self._node.base_frame:
            if frame not in self._transforms or steps > len(self._transforms):
                return None
            frame, T_parent_child = self._transforms[frame]
            pose, steps = T_parent_child @ pose, steps + 1
        return pose
