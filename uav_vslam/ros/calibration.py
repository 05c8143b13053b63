# SPDX-License-Identifier: Apache-2.0
"""The stereo rig from topics: intrinsics from camera_info, extrinsics from /tf_static."""

from collections.abc import Callable
from functools import partial

from rclpy.logging import get_logger
from sensor_msgs.msg import CameraInfo
from tf2_msgs.msg import TFMessage

from uav_vslam.datasets.bag import walk
from uav_vslam.datasets.messages import transforms_of
from uav_vslam.errors import CalibrationError, InvalidMessage
from uav_vslam.geometry.camera import PinholeCamera
from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.stereo import StereoRig
from uav_vslam.ros.convert import camera_from_msg
from uav_vslam.ros.qos import LATCHED, STATE
from uav_vslam.ros.runtime import VehicleNode


class RigListener:
    """Collects calibration and extrinsics; `rig` is None until complete, then `on_complete` is called once.

    Topics are not ordered among each other: images may arrive before their calibration.
    """

    def __init__(self, node: VehicleNode, on_complete: Callable[[], None]) -> None:
        self._node, self._on_complete = node, on_complete
        self._cameras: dict[str, tuple[PinholeCamera, str]] = {}
        self._transforms: dict[str, tuple[str, Pose]] = {}  # child frame -> (parent frame, T_parent_child)
        self.rig: StereoRig | None = None
        for side in ("left", "right"):
            node.listen(CameraInfo, f"{side}/camera_info", partial(self._on_camera, side), STATE)
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
        for parent, child, T_parent_child in transforms_of(message):
            self._transforms[child] = (parent, T_parent_child)
        self._assemble()

    def _assemble(self) -> None:
        if self.rig is not None or len(self._cameras) < 2:
            return
        (left, left_frame), (right, right_frame) = self._cameras["left"], self._cameras["right"]
        base = self._node.base_frame
        T_body_left, T_body_right = (walk(self._transforms, f, base) for f in (left_frame, right_frame))
        if T_body_left is None or T_body_right is None:
            return
        try:
            self.rig = StereoRig(left, right, T_body_left, T_body_right)
        except CalibrationError as error:
            self._cameras.clear()  # later ones may be valid
            raise InvalidMessage("calibration", str(error)) from None
        get_logger(self._node.get_name()).info(f"rig complete: baseline {self.rig.baseline_m:.3f} m")
        self._on_complete()
